//! Schema of iterations.

use peernet_analysis::slowness::{Cause, REST_OF_UNATTRIBUTED};
use peernet_logger::{Name, stage};
use peernet_store as store;
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::schema::{Assumptions, NodeFigures, time};

/// Iterations by increasing number, or the slowest first.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct IterationList {
    pub iterations: Vec<IterationSummary>,
    /// `after` of the next page; null on the last.
    pub next: Option<u64>,
}

/// An iteration in a list.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct IterationSummary {
    /// Number within the run, contiguous from 1.
    pub number: u64,
    pub episode: u32,
    pub step: u32,
    pub warm_up: bool,
    /// `ok`, `failed`, `lost` or `timeout`.
    pub outcome: &'static str,
    pub reason: Option<String>,
    pub started: String,
    /// Seconds from the intended start to the end.
    pub total: Option<f64>,
    /// Ratio of `total` to the run's median of `total`.
    pub factor: Option<f64>,
    /// First element of `causes`; null if `causes` is empty.
    pub blame: Option<SlowPart>,
    /// Causes of a slow iteration: the parts that exceed their own medians most, largest excess first, until they explain 80 % of the
    /// excess of `total`. A part is a stage, `lateness`, `unattributed` (without lateness), or `upload + download`. Empty if the
    /// iteration took less than 1.05 times the run's median.
    pub causes: Vec<SlowPart>,
    /// Seconds of each stage, in the order of the stages.
    pub stages: Vec<StageTime>,
    /// Part of `total` that the stages do not account for, seconds.
    pub unattributed: Option<f64>,
    /// Sum of `upload` and `download`, seconds, if one of them has no value: the time that the edge waited minus the time that the cloud
    /// took. `total` is then the sum of `both_ways`, `unattributed` and the other stages. Null if both have values.
    pub both_ways: Option<f64>,
}

/// Seconds of a stage.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct StageTime {
    pub name: String,
    /// Duration, seconds; null for a one-way delay without a value.
    pub seconds: Option<f64>,
    /// Accuracy of a one-way delay; null for other stages.
    pub delay: Option<StageDelay>,
}

/// Accuracy of a one-way delay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct StageDelay {
    /// Receiver's stamp minus sender's stamp, each by the wall clock of its host, seconds; may be negative.
    pub raw_s: f64,
    /// Lower end of the interval that contains the true delay; null when nothing is known.
    pub lo_s: Option<f64>,
    /// Upper end of the interval.
    pub hi_s: Option<f64>,
    /// Source of the interval: `same-clock`, `in-band`, `kernel`, `chrony`, `intersection` or `none`.
    pub source: &'static str,
    /// `ok`, `limited`, `stale`, `unsynchronised`, `stepped` or `inconsistent`.
    pub verdict: &'static str,
    /// `true` if claims of time daemons narrowed the interval.
    pub claims_used: bool,
    /// Further assumptions of the interval; null if both hosts read one clock, or no clock sample of that time is stored.
    pub assumptions: Option<Assumptions>,
}

impl StageDelay {
    /// Returns the iteration's delay of a stage. `None` if the stage has no delay, or if it occurs several times: the
    /// stage's value is then the sum of several delays, and no single delay describes the accuracy of the sum.
    pub(crate) fn find(row: &store::IterationRow, stage: &Name) -> Option<Self> {
        let mut delays_of_stage = row.delays.iter().filter(|delay| delay.stage == *stage);
        let delay = delays_of_stage.next().filter(|_| delays_of_stage.next().is_none())?;
        Some(Self {
            raw_s: delay.raw,
            // Negative bounds are not raised to zero: in an observed system, the delay is the difference between two
            // receivers of one message, and may be negative.
            lo_s: delay.bounds.map(|(lo, _)| lo),
            hi_s: delay.bounds.map(|(_, hi)| hi),
            source: delay.source.name(),
            verdict: delay.verdict.name(),
            claims_used: delay.source.uses_claims(),
            assumptions: delay.assumptions.as_ref().map(Assumptions::from),
        })
    }
}

impl StageTime {
    /// Returns the stages of an iteration in their order, including stages that have only a raw difference of stamps.
    fn all(row: &store::IterationRow) -> Vec<Self> {
        let stage_time = |stage: Name| {
            let seconds = row.stages.iter().find(|(name, _)| *name == stage).map(|(_, seconds)| *seconds);
            let has_delay = row.delays.iter().any(|delay| delay.stage == stage);
            let delay = StageDelay::find(row, &stage);
            (seconds.is_some() || has_delay).then(|| Self { name: stage.to_string(), seconds, delay })
        };
        stage::ORDER.into_iter().filter_map(stage_time).collect()
    }
}

/// A part of an iteration that took longer than the median of its run.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = Blame)]
pub(crate) struct SlowPart {
    pub name: String,
    pub seconds: f64,
    /// Median of the run.
    pub median: f64,
}

impl From<&Cause> for SlowPart {
    fn from(cause: &Cause) -> Self {
        // In the list of causes, the API has always called the rest without the lateness `unattributed`.
        let name = if cause.name == REST_OF_UNATTRIBUTED { stage::UNATTRIBUTED } else { cause.name.clone() };
        Self { name: name.to_string(), seconds: cause.value, median: cause.median }
    }
}

impl From<&store::IterationRow> for IterationSummary {
    fn from(row: &store::IterationRow) -> Self {
        Self {
            number: row.number,
            episode: row.episode,
            step: row.step,
            warm_up: row.warm_up,
            outcome: row.outcome.name(),
            reason: row.reason.clone(),
            started: time(row.started),
            total: row.total,
            factor: row.factor,
            blame: row.causes.first().map(SlowPart::from),
            causes: row.causes.iter().map(SlowPart::from).collect(),
            stages: StageTime::all(row),
            unattributed: row.unattributed,
            both_ways: row.both_ways,
        }
    }
}

/// One iteration with its tree.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Iteration {
    #[serde(flatten)]
    pub summary: IterationSummary,
    /// The logger's tree as the agent sent it: `anchors` (host, wall-clock zero in Unix nanoseconds) and
    /// `nodes` (parent's position, name, host's position, start in nanoseconds from that zero, measure).
    #[schema(value_type = Object)]
    pub tree: serde_json::Value,
    /// Names of the hosts of the tree's anchors.
    pub hosts: Vec<Option<String>>,
    /// Rank among the slowest successful iterations of the run, from 1; null beyond the 1,000 slowest, and for an
    /// iteration that the statistics exclude.
    pub rank: Option<u64>,
    /// Number of the previous stored iteration.
    pub previous: Option<u64>,
    /// Number of the next stored iteration.
    pub next: Option<u64>,
    /// Figures of the whole run, for comparison.
    pub run_figures: Vec<NodeFigures>,
}

impl TryFrom<&store::IterationDetail> for Iteration {
    type Error = serde_json::Error;
    fn try_from(detail: &store::IterationDetail) -> Result<Self, serde_json::Error> {
        Ok(Self {
            summary: IterationSummary::from(&detail.row),
            tree: serde_json::to_value(&detail.tree)?,
            hosts: detail.hosts.iter().map(|host| host.as_ref().map(ToString::to_string)).collect(),
            rank: detail.rank,
            previous: detail.previous,
            next: detail.next,
            run_figures: NodeFigures::from_values(&detail.run_figures),
        })
    }
}
