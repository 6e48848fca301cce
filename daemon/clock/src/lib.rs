//! Clocks and times: types for instants and their differences, the injected [`Clock`], and one-way delays between two
//! hosts, each with an interval that contains the true delay.
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
//! - `identity`: tells apart the clocks of different machines, boots and processes.
//! - `source`: the [`Clock`] trait and the system's clock; `manual`: a clock for tests; `faulty_clock`: a clock with
//!   injected faults, which `clock_faults` describes.
//! - `steps`: detects steps and slews of a wall clock, and sleeps of the machine.
//! - `exchange`: four stamps and the bounds of the offset that follow from them; `clock_claim`: the error bounds that a
//!   time daemon claims for a wall clock.
//! - `band`: the interval of the offset over time that all exchanges together prove, and the estimate within it.
//! - `related_clocks`: which clocks of the two hosts are related, free-running clocks or wall clocks.
//! - `relation`: the clocks of one pair of hosts: accepts or refuses exchanges, combines the sources of the offset, and
//!   corrects delays.
//! - `delay`: the result, a [`OneWayDelay`] with its interval, its source and its verdict.
//! - `log_throttle`: limits repeated log lines to one per minute.

mod band;
mod clock_claim;
mod clock_faults;
mod delay;
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
pub use clock_claim::ClockClaim;
pub use clock_faults::{ClockFaultStep, ClockFaults, SteppedClock};
pub use delay::{DelaySource, Interval, OneWayDelay, Verdict};
pub use exchange::{Exchange, ExchangeObservation};
pub use faulty_clock::FaultyClock;
pub use identity::{ClockIdentity, time_namespace};
pub use log_throttle::LogThrottle;
pub use manual::ManualClock;
pub use related_clocks::RelatedClocks;
pub use relation::{
    Direction, ExchangeCounts, JudgedExchange, LearnResult, MIN_EXCHANGES_FOR_FRESHNESS, Offset, Refusal,
    Relation, RelationSettings, ViolatedLimit,
};
pub use source::{Clock, SharedClock, Stamp, SystemClock};
pub use steps::{ClockWatch, Disturbance, Readings};
pub use time::{MonoTime, RawTime, Span, WallTime};
