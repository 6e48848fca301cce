//! Schema types that several resources share.
//!
//! They are separate from the types of the aggregator and the store, so that a change of the aggregator's or the store's
//! types does not change the API. The API shares only [`QuantityStatistics`](peernet_store::QuantityStatistics) with the
//! store.
//!
//! Values are in units without prefixes (seconds, bytes, bits per second, watts, °C), times in RFC 3339 with
//! nanoseconds, in UTC. Names of fields have underscores, names of stages and kinds have hyphens.

mod assumptions;
mod clock;
mod condition;
mod figures;
mod pipelines;

use chrono::{SecondsFormat, TimeZone, Utc};
use peernet_clock::WallTime;

pub(crate) use assumptions::Assumptions;
pub(crate) use clock::HostClock;
pub(crate) use condition::{Condition, grade_name};
pub(crate) use figures::{Bound, Counts, NodeFigures, Placement, VerdictCount};
pub(crate) use pipelines::{Pipeline, PipelineList};

/// Returns a time in RFC 3339: `2026-11-19T12:01:07.400000000Z`.
pub(crate) fn time(time: WallTime) -> String {
    Utc.timestamp_nanos(time.unix_nanos()).to_rfc3339_opts(SecondsFormat::Nanos, true)
}
