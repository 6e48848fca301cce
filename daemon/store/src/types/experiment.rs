//! Experiments, and values of runs over time, from which runs are compared and judged.

use peernet_analysis::run_selection::{Candidate, Repeat, RunState};
use peernet_clock::{Span, WallTime};
use peernet_logger::Name;
use peernet_statistics::Summary;
use serde::Serialize;

use super::RunSummary;

/// An experiment in a list: runs that were declared together.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ExperimentSummary {
    /// Random id; the same for all runs of one execution of the experiment.
    pub id: String,
    /// Name in the experiment's file.
    pub name: String,
    /// Number of runs that have started.
    pub runs: u64,
    /// Number of runs that have not ended.
    pub open: u64,
    /// The experiment's first run, by its number (`#12`).
    #[serde(rename = "oldest")]
    pub first_run: i64,
    /// The experiment's last run, by its number.
    #[serde(rename = "newest")]
    pub last_run: i64,
    /// Start of the first run, on its edge's wall clock.
    pub started: WallTime,
}

impl From<&RunSummary> for Candidate {
    fn from(run: &RunSummary) -> Self {
        let membership = run.experiment.as_ref();
        Self {
            id: Some(run.id),
            state: Some(RunState::from_end_reason(run.reason.as_ref())),
            repeat: membership.map(|membership| Repeat::new(membership, run.host, run.pipeline.as_str())),
            edges: membership.and_then(|membership| membership.edges),
            times: Some((run.started, run.end_time().unwrap_or(run.started))),
            sequence: run.number,
            // Only the command line names runs and ranks results.
            is_named: false,
            rank: 0,
        }
    }
}

/// Summaries of the values of one node name, one for each bucket of a run's time.
#[derive(Clone, Debug, PartialEq)]
pub struct StageBuckets {
    /// The node's name.
    pub stage: Name,
    /// Unit of the values.
    pub unit: String,
    /// Summaries of the buckets that have values, oldest first.
    pub buckets: Vec<Summary>,
    /// Start of each bucket in `buckets`.
    pub bucket_starts: Vec<WallTime>,
    /// Width of a bucket.
    pub bucket_width: Span,
}

/// The means of one node name over the time of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct StageMeans {
    /// The node's name.
    pub stage: Name,
    /// Buckets that have values, oldest first.
    pub buckets: Vec<MeanBucket>,
}

/// Number and mean of the values in one bucket.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanBucket {
    /// Start of the bucket, on the edge's wall clock; a multiple of the bucket's width.
    pub at: WallTime,
    /// Number of values.
    pub count: u64,
    /// Mean of the values.
    pub mean: f64,
}
