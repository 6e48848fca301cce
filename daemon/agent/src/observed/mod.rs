//! Stamps of messages that this host's pipelines observe, for agents of other hosts that observe the same messages.
//!
//! `messages` is what the two agents say to each other, `ring` what is kept of a pipeline, and `pipelines` what a peer is
//! answered. No I/O: the session is `serve`'s.

mod messages;
mod pipelines;
mod ring;

pub(crate) use messages::{MAX_KEYS, ObservedPair, StampAnswer, StampRequest};
pub(crate) use pipelines::{MODEL, ObservedPipeline, ObservedPipelines};
pub(crate) use ring::Side;
