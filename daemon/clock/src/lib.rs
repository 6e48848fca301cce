//! Time: instants and differences that cannot be mixed up, the injected [`Clock`], and one-way delays
//! between two hosts with the interval that contains the truth.
//!
//! No I/O beyond reading the operating system's clocks. Everything else in the workspace takes time from
//! here, through a `Clock` it was given, so that every test can control it (`clippy.toml` enforces it).

mod delay;
mod identity;
mod manual;
mod relation;
mod source;
mod time;

pub use delay::{DelaySource, Interval, OneWayDelay, Verdict};
pub use identity::ClockIdentity;
pub use manual::ManualClock;
pub use relation::{Direction, Relation};
pub use source::{Clock, SharedClock, Stamp, SystemClock};
pub use time::{MonoTime, Span, WallTime};
