//! Time: instants and differences that cannot be mixed up, the injected [`Clock`], and one-way delays
//! between two hosts with the interval that contains the truth.
//!
//! No I/O beyond reading the operating system's clocks. Everything else in the workspace takes time from
//! here, through a `Clock` it was given, so that every test can control it (`clippy.toml` enforces it).
//!
//! From the ground up:
//!
//! - `time`: [`WallTime`], [`MonoTime`], [`RawTime`] and their difference, [`Span`].
//! - `system`: reads the operating system's clocks.
//! - `source`: the [`Clock`] and the system's; `manual`, one that tests move; `rehearsed`, one that is wrong on
//!   purpose, by what `rehearsal` describes.
//! - `steps`: notices that a wall clock was set, runs off, or slept.
//! - `exchange`: four stamps and the bounds of the offset that follow; `discipline`: what a time daemon claims.
//! - `band`: what all exchanges together prove, as an interval over time, and the best guess in it.
//! - `related_clocks`: which clocks of two hosts those exchanges relate.
//! - `relation`: one pair of hosts: which exchanges count, what the sources come to, how a delay is judged.
//! - `log_throttle`: log lines that repeat, once a minute.
//! - `delay`: the answer, a [`OneWayDelay`] with its interval, its source and its verdict.

mod band;
mod delay;
mod discipline;
mod exchange;
mod identity;
mod log_throttle;
mod manual;
mod rehearsal;
mod rehearsed;
mod related_clocks;
mod relation;
#[cfg(test)]
mod simulation;
mod source;
mod steps;
mod system;
mod time;

pub use band::ProvenSkew;
pub use delay::{DelaySource, Interval, OneWayDelay, Verdict};
pub use discipline::Discipline;
pub use exchange::{Exchange, ExchangeObservation};
pub use identity::{ClockIdentity, time_namespace};
pub use log_throttle::LogThrottle;
pub use manual::ManualClock;
pub use rehearsal::{RehearsalDescription, RehearsedStep, SteppedClock};
pub use rehearsed::RehearsedClock;
pub use related_clocks::RelatedClocks;
pub use relation::{
    Direction, Doubt, ExchangeCounts, Judged, Learned, Offset, Refusal, Relation, RelationSettings,
};
pub use source::{Clock, SharedClock, Stamp, SystemClock};
pub use steps::{Disturbance, Readings, Watch};
pub use time::{MonoTime, RawTime, Span, WallTime};
