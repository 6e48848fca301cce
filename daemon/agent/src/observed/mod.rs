//! Stamps of the messages that this host's pipelines observe. Agents on other hosts that observe the same messages
//! query these stamps.
//!
//! `messages` defines requests and answers, `ring` keeps the newest stamps of a pipeline, and `pipelines` answers
//! requests. No I/O: `serve` owns the session.

mod messages;
mod pipelines;
mod ring;

pub(crate) use messages::{MAX_KEYS, ObservedPair, StampAnswer, StampRequest};
pub(crate) use pipelines::{ObservedPipeline, ObservedPipelines, STAMPS_MODEL};
pub(crate) use ring::Side;
