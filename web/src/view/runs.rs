//! Runs in a list.

use peernet_aggregator::RunSummary;
use peernet_clock::WallTime;

use super::place;
use crate::numbers::{NONE, count, length, percent, total_ms};
use crate::zone::{Moment, Zone};

/// One run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RunLine {
    pub number: i64,
    pub pipeline: String,
    pub route: String,
    pub model: String,
    pub started: Moment,
    pub lasted: String,
    /// `None` while it goes on.
    pub reason: Option<String>,
    pub iterations: String,
    pub lost: String,
    pub p50: String,
    pub p95: String,
    pub p99: String,
}

/// Share of iterations without an answer.
pub(crate) fn lost_share(run: &RunSummary) -> Option<f64> {
    let counts = &run.counts;
    (counts.total() > 0).then(|| (counts.total() - counts.ok) as f64 / counts.total() as f64)
}

/// When the run ended, or how far it has come.
pub(crate) fn end(run: &RunSummary) -> Option<WallTime> {
    run.ended.or(run.last_iteration)
}

impl RunLine {
    pub(crate) fn new(run: &RunSummary, zone: Zone) -> Self {
        let quantile = |value: Option<f64>| value.map_or_else(|| NONE.to_owned(), total_ms);
        let total = run.total.as_ref();
        Self {
            number: run.number,
            pipeline: run.pipeline.to_string(),
            route: place::route(run.host_name.as_str(), &run.placement),
            model: place::model(&run.placement),
            started: zone.moment(run.started),
            lasted: end(run).map_or_else(|| NONE.to_owned(), |end| length((end - run.started).seconds())),
            reason: run.ended.map(|_| run.reason.clone().unwrap_or_else(|| "ended".to_owned())),
            iterations: count(run.counts.total()),
            lost: lost_share(run).map_or_else(|| NONE.to_owned(), percent),
            p50: quantile(total.map(|total| total.p50)),
            p95: quantile(total.and_then(|total| total.p95)),
            p99: quantile(total.and_then(|total| total.p99)),
        }
    }
}
