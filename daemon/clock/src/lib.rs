//! Clocks and times: instants and differences that cannot be mixed up, the injected [`Clock`], and one-way delays
//! between two hosts with an interval that contains the true delay.
//!
//! The crate does no I/O beyond reading the operating system's clocks. All other crates get the time through a `Clock`
//! that is passed to them, so that tests can control it (`clippy.toml` enforces this).
//!
//! Durations within one host are differences of its monotonic clock. Only `upload` and `download` compare the clocks of
//! two hosts.
//!
//! Modules, from the lowest layer up:
//!
//! - `time`: [`WallTime`], [`MonoTime`], [`RawTime`] and their difference, [`Span`].
//! - `system`: reads the operating system's clocks.
//! - `source`: the [`Clock`] trait and the system's clock; `manual`: a clock for tests; `faulty_clock`: a clock with
//!   injected faults, which `faults` describes.
//! - `steps`: detects that a wall clock was stepped or is slewed, and that the machine slept.
//! - `exchange`: four stamps and the bounds of the offset that follow from them; `discipline`: error bounds that a time
//!   daemon claims.
//! - `band`: the interval over time that all exchanges together prove, and the estimate within it.
//! - `related_clocks`: the clocks of two hosts that the exchanges relate.
//! - `relation`: one pair of hosts: accepts or refuses exchanges, combines the sources, and judges delays.
//! - `log_throttle`: limits repeated log lines to one per minute.
//! - `delay`: the result, a [`OneWayDelay`] with its interval, its source and its verdict.

mod band;
mod clock_faults;
mod delay;
mod discipline;
mod exchange;
mod faulty_clock;
mod identity;
mod log_throttle;
mod manual;
mod related_clocks;
mod relation;
#[cfg(test)]
mod simulation;
mod source;
mod steps;
mod system;
mod time;

pub use band::ProvenSkew;
pub use clock_faults::{ClockFaultStep, ClockFaults, SteppedClock};
pub use delay::{DelaySource, Interval, OneWayDelay, Verdict};
pub use discipline::Discipline;
pub use exchange::{Exchange, ExchangeObservation};
pub use faulty_clock::FaultyClock;
pub use identity::{ClockIdentity, time_namespace};
pub use log_throttle::LogThrottle;
pub use manual::ManualClock;
pub use related_clocks::RelatedClocks;
pub use relation::{
    Direction, Doubt, ExchangeCounts, JudgedExchange, LearnResult, Offset, Refusal, Relation,
    RelationSettings,
};
pub use source::{Clock, SharedClock, Stamp, SystemClock};
pub use steps::{ClockWatch, Disturbance, Readings};
pub use time::{MonoTime, RawTime, Span, WallTime};
