//! Time: instants and differences that cannot be mixed up, the injected [`Clock`], and one-way delays
//! between two hosts with the interval that contains the truth.
//!
//! No I/O beyond reading the operating system's clocks. Everything else in the workspace takes time from
//! here, through a `Clock` it was given, so that every test can control it (`clippy.toml` enforces it).

mod band;
mod delay;
mod discipline;
mod exchange;
mod identity;
mod manual;
mod rehearsal;
mod relation;
#[cfg(test)]
mod simulation;
mod source;
mod steps;
mod time;

pub use delay::{DelaySource, Interval, OneWayDelay, Verdict};
pub use discipline::Discipline;
pub use exchange::{Exchange, Witnessed};
pub use identity::ClockIdentity;
pub use manual::ManualClock;
pub use rehearsal::{RehearsalDescription, RehearsedClock, RehearsedStep};
pub use relation::{Direction, ExchangeCounts, Judged, Learned, Offset, Refusal, Relation, RelationSettings};
pub use source::{Clock, SharedClock, Stamp, SystemClock};
pub use steps::{Disturbance, Readings, Watch};
pub use time::{MonoTime, Span, WallTime};
