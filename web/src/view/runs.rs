//! Runs in a list.

use peernet_aggregator::{Picture, RetentionConfig, RunSummary};
use peernet_clock::WallTime;

use super::chip::{Chip, Tone};
use super::notes::Note;
use super::{place, rehearsal};
use crate::numbers::{NONE, count, length, percent, total_ms};
use crate::zone::{Moment, Zone};

/// The chip of a run of which retention deletes nothing.
pub(crate) const KEPT: Chip = Chip::new(Tone::Quiet, "pin", "kept");

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
    pub kept: Option<Chip>,
}

/// Why iterations are deleted: `after 7 days`.
pub(crate) fn why_deleted(retention: &RetentionConfig) -> String {
    match (retention.nodes_days, retention.size_limit_bytes) {
        (1, 0) => "after 1 day".to_owned(),
        (days, 0) if days > 0 => format!("after {} days", count(days.into())),
        _ => "because of their age or for want of room".to_owned(),
    }
}

/// What retention deleted of a run: which iterations, and what of them.
pub(crate) fn trimmed(run: &RunSummary, retention: &RetentionConfig) -> Option<Note> {
    let which = match run.nodes_from {
        0 => return None,
        1 => "Iteration 1".to_owned(),
        last => format!("Iterations 1 to {}", count(last)),
    };
    Some(Note {
        chip: Chip::new(Tone::Quiet, "gap", "deleted"),
        subject: which,
        href: String::new(),
        text: format!("can no longer be opened: deleted {}. The statistics remain.", why_deleted(retention)),
        link: None,
    })
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
            kept: run.pinned.then_some(KEPT),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn why_something_was_deleted_is_said_as_far_as_it_is_known() {
        let why = |nodes_days, size_limit_bytes| {
            why_deleted(&RetentionConfig { nodes_days, size_limit_bytes, ..RetentionConfig::default() })
        };
        assert_eq!((why(7, 0).as_str(), why(1, 0).as_str()), ("after 7 days", "after 1 day"));
        assert_eq!(why(7, 1 << 30), "because of their age or for want of room");
        assert_eq!(
            why(0, 0),
            "because of their age or for want of room",
            "the configuration was another one"
        );
    }
}
