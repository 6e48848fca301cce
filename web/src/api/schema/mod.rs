//! Schema that several resources share. It is separate from the aggregator's own types, so that answers stay the same when those change.
//!
//! Values are in units without prefixes (seconds, bytes, bits per second, watts, °C), names with hyphens, times in RFC
//! 3339 with nanoseconds, in UTC.

mod assumptions;
mod clock;
mod condition;
mod figures;
mod pipelines;

use chrono::{SecondsFormat, TimeZone, Utc};
use peernet_clock::WallTime;

pub(crate) use assumptions::Assumptions;
pub(crate) use clock::HostClock;
pub(crate) use condition::{Condition, word};
pub(crate) use figures::{Bound, Counts, NodeFigures, Placement, VerdictCount};
pub(crate) use pipelines::{Pipeline, PipelineList};

/// Returns a moment as text: `2026-11-19T12:01:07.400000000Z`.
pub(crate) fn time(time: WallTime) -> String {
    Utc.timestamp_nanos(time.unix_nanos()).to_rfc3339_opts(SecondsFormat::Nanos, true)
}
