//! Schema of stored runs.

use peernet_analysis::deadline::Misses;
use peernet_store::{self as store, QuantityStatistics};
use peernet_stream as stream;
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::schema::{Condition, Counts, Placement, time};

/// Runs, newest first.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct RunList {
    pub runs: Vec<Run>,
    /// `before` of the next page; null on the last.
    pub next: Option<i64>,
}

/// One pipeline configuration executed for many iterations.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Run {
    /// Number of the run on pages and in addresses: `{run}` in the paths of this API.
    pub number: i64,
    pub id: String,
    /// Name of the edge host.
    pub host: String,
    pub pipeline: String,
    pub placement: Placement,
    /// Start of the run, on the edge's wall clock.
    pub started: String,
    /// Time of the end. Null while the run has not ended, and if no end was reported because the agent was killed or is
    /// disconnected.
    pub ended: Option<String>,
    /// Reason of the end: `finished`, `stopped`, or an error.
    pub reason: Option<String>,
    /// Start of the newest stored iteration.
    pub last_iteration: Option<String>,
    /// Iterations by outcome, without warm-up.
    pub counts: Counts,
    /// Number of warm-up iterations.
    pub warm_up: u64,
    /// Number of starts of an open loop that were skipped because the pipeline was too far behind its schedule, without
    /// warm-up. Each iteration records the starts skipped before it. They count even if the iteration failed.
    pub skipped_starts: u64,
    /// Deadline of an iteration, seconds; null without a deadline.
    pub deadline_s: Option<f64>,
    /// Share of iterations that took longer than the deadline or failed, 0 to 1, without warm-up; null without a
    /// deadline, and before the first iteration.
    pub miss_rate: Option<f64>,
    /// Number of answers that were not acted on, because the answer to a newer sample had been acted on or the episode
    /// had ended.
    pub superseded: u64,
    /// Share of the episodes that were a success, 0 to 1, without the warm-up; null if the actuator reports no success.
    pub success_rate: Option<f64>,
    /// Mean return of the episodes. The return is the sum of the rewards of an episode; null if the actuator reports no
    /// rewards.
    pub episode_return: Option<f64>,
    /// Statistics of `total`, seconds; successful iterations only.
    pub total: Option<QuantityStatistics>,
    /// `true` if clock faults were injected on a host of the run.
    #[serde(rename = "rehearsed")]
    pub has_clock_fault: bool,
    /// `true` if the run is pinned: retention deletes nothing of it.
    pub pinned: bool,
    /// Number of the last iteration deleted because of its age or to free space; 0 if none was deleted. The statistics
    /// of deleted iterations remain.
    pub deleted_through: u64,
    /// Position in an experiment; null if the run belongs to none.
    pub experiment: Option<ExperimentPosition>,
}

/// The position of a run in an experiment.
// The REST API keeps the former name of this type.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = ExperimentPlace)]
pub(crate) struct ExperimentPosition {
    pub name: String,
    /// Id of the experiment; equal for all runs of one execution.
    pub id: String,
    /// Settings that distinguish this configuration from the others.
    pub configuration: Vec<Fact>,
    /// Number of the repeat, from 0.
    pub repeat: u32,
}

impl From<&stream::ExperimentPosition> for ExperimentPosition {
    fn from(position: &stream::ExperimentPosition) -> Self {
        let stream::ExperimentPosition { name, id, configuration, repeat, .. } = position.clone();
        let fact = |(name, value)| Fact { name, value };
        Self { name, id, configuration: configuration.into_iter().map(fact).collect(), repeat }
    }
}

impl From<&store::RunSummary> for Run {
    fn from(run: &store::RunSummary) -> Self {
        Self {
            number: run.number,
            id: run.id.to_string(),
            host: run.host_name.to_string(),
            pipeline: run.pipeline.to_string(),
            placement: Placement::from(&run.placement),
            started: time(run.started),
            ended: run.ended.map(time),
            reason: run.reason.as_ref().map(ToString::to_string),
            last_iteration: run.last_iteration.map(time),
            counts: run.counts.into(),
            warm_up: run.warm_up,
            skipped_starts: run.skipped_starts,
            deadline_s: run.deadline_s,
            miss_rate: run.misses.and_then(Misses::rate),
            superseded: run.actuator.superseded,
            success_rate: run.actuator.success.map(|success| success.rate),
            episode_return: run.actuator.episode_return.map(|found| found.mean),
            total: run.total,
            has_clock_fault: run.has_clock_fault,
            pinned: run.pinned,
            deleted_through: run.last_deleted_iteration,
            experiment: run.experiment.as_ref().map(ExperimentPosition::from),
        }
    }
}

/// A run with its configuration and gaps.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct RunDetail {
    #[serde(flatten)]
    pub run: Run,
    /// Sensor, transforms, load and other settings as readable text.
    pub facts: Vec<Fact>,
    /// The pipeline's table of the configuration file (TOML).
    pub configuration: String,
    /// Version of the agent.
    pub version: String,
    /// Results of the checks of the hosts before the run; empty if they were not checked.
    pub conditions: Vec<Condition>,
    pub gaps: Vec<Gap>,
}

/// One fact of a configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Fact {
    pub name: String,
    pub value: String,
}

/// A gap: a number of events that never reached the store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Gap {
    pub from: String,
    pub to: String,
    /// Number of missing events; 0 if unknown.
    pub count: u64,
    pub reason: String,
    /// Number of gaps that are combined in this entry: 1, or more after the first 1,000 gaps of a run.
    pub gaps: u64,
}

impl From<&store::GapRow> for Gap {
    fn from(gap: &store::GapRow) -> Self {
        Self {
            from: time(gap.from),
            to: time(gap.to),
            count: gap.count,
            reason: gap.reason.clone(),
            gaps: gap.gaps,
        }
    }
}

impl From<&store::RunDetail> for RunDetail {
    fn from(detail: &store::RunDetail) -> Self {
        let facts = detail.facts.iter();
        Self {
            run: Run::from(&detail.summary),
            facts: facts.map(|(name, value)| Fact { name: name.clone(), value: value.clone() }).collect(),
            configuration: detail.configuration.clone(),
            version: detail.version.clone(),
            conditions: detail.conditions.iter().map(Condition::from).collect(),
            gaps: detail.gaps.iter().map(Gap::from).collect(),
        }
    }
}
