//! What the API says: the aggregator's answers in a form that stays the same when the inside changes.
//!
//! Values are in SI base units (seconds, bytes, bits per second, watts, °C), names with hyphens, times in RFC
//! 3339 with nanoseconds, in UTC.

mod clock;
mod compare;
mod figures;
mod hosts;
mod iterations;
mod links;
mod live;
mod runs;
mod trust;

use chrono::{SecondsFormat, TimeZone, Utc};
use peernet_clock::WallTime;

pub(crate) use clock::{HostClock, Recomputed};
pub(crate) use compare::{Comparison, Experiment, ExperimentList};
pub(crate) use figures::{Bound, Counts, Figures, NodeFigures, Placement};
pub(crate) use hosts::{Host, HostList, Incident, IncidentList, RefusedHost};
pub(crate) use iterations::{Iteration, IterationList, IterationSummary};
pub(crate) use links::{Link, LinkList, LinkSeries};
pub(crate) use live::{PictureEvent, Pipeline, PipelineList, StatusEvent};
pub(crate) use runs::{Histogram, Run, RunDetail, RunList, Series, Stage, StageList};
pub(crate) use trust::{Condition, Trust};

/// A moment as text: `2026-11-19T12:01:07.400000000Z`.
pub(crate) fn time(time: WallTime) -> String {
    Utc.timestamp_nanos(time.unix_nanos()).to_rfc3339_opts(SecondsFormat::Nanos, true)
}
