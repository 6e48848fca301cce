//! Runs in a list.

use peernet_aggregator::{Picture, RunSummary};
use peernet_clock::WallTime;

use super::chip::Chip;
use super::{place, rehearsal};
use crate::numbers::{NONE, count, length, percent, total_ms};
use crate::zone::{Moment, Zone};

/// What is known of a run's end.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum End {
    /// It goes on: its host says so.
    GoesOn,
    /// It ended, for this reason.
    Told(String),
    /// Its agent was killed or is away: when its last stored iteration began.
    Untold(Option<Moment>),
}

impl End {
    pub(crate) fn of(run: &RunSummary, picture: &Picture, zone: Zone) -> Self {
        if run.ended.is_some() {
            return Self::Told(run.reason.clone().unwrap_or_else(|| "ended".to_owned()));
        }
        let connected = || picture.hosts.iter().any(|host| host.id == run.host && host.connected);
        let current = picture.pipelines.iter().any(|one| one.host == run.host && one.run == Some(run.id));
        if current && connected() {
            return Self::GoesOn;
        }
        Self::Untold(run.last_iteration.map(|at| zone.moment(at)))
    }
}

/// One run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RunLine {
    pub number: i64,
    pub pipeline: String,
    pub route: String,
    pub model: String,
    pub started: Moment,
    pub lasted: String,
    pub end: End,
    pub iterations: String,
    pub lost: String,
    pub p50: String,
    pub p95: String,
    pub p99: String,
    pub rehearsal: Option<Chip>,
}

/// Share of iterations without an answer.
pub(crate) fn lost_share(run: &RunSummary) -> Option<f64> {
    let counts = &run.counts;
    (counts.total() > 0).then(|| (counts.total() - counts.ok) as f64 / counts.total() as f64)
}

/// When the run ended, or how far it is known to have come.
pub(crate) fn end(run: &RunSummary) -> Option<WallTime> {
    run.ended.or(run.last_iteration)
}

impl RunLine {
    pub(crate) fn new(run: &RunSummary, picture: &Picture, zone: Zone) -> Self {
        let quantile = |value: Option<f64>| value.map_or_else(|| NONE.to_owned(), total_ms);
        let total = run.total.as_ref();
        Self {
            number: run.number,
            pipeline: run.pipeline.to_string(),
            route: place::route(run.host_name.as_str(), &run.placement),
            model: place::model(&run.placement),
            started: zone.moment(run.started),
            lasted: end(run).map_or_else(|| NONE.to_owned(), |end| length((end - run.started).seconds())),
            end: End::of(run, picture, zone),
            iterations: count(run.counts.total()),
            lost: lost_share(run).map_or_else(|| NONE.to_owned(), percent),
            p50: quantile(total.map(|total| total.p50)),
            p95: quantile(total.and_then(|total| total.p95)),
            p99: quantile(total.and_then(|total| total.p99)),
            rehearsal: run.rehearsed.then_some(rehearsal::CHIP),
        }
    }
}
