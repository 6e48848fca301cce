//! Iterations of a run.

use peernet_aggregator as aggregator;
use serde::Serialize;
use utoipa::ToSchema;

use super::{NodeFigures, time};

/// Iterations by rising number, or the slowest first.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct IterationList {
    pub iterations: Vec<IterationSummary>,
    /// `after` of the next page; null on the last.
    pub next: Option<u64>,
}

/// An iteration in a list.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct IterationSummary {
    /// Contiguous from 1 within the run.
    pub number: u64,
    pub episode: u32,
    pub step: u32,
    pub warm_up: bool,
    /// `ok`, `failed`, `lost` or `timeout`.
    pub outcome: String,
    pub reason: Option<String>,
    pub started: String,
    /// Seconds from the intended start to the end.
    pub total: Option<f64>,
    /// `total` over the run's median of it.
    pub factor: Option<f64>,
    /// What took longest beyond its own median: a stage, or `unattributed`.
    pub blame: Option<Blame>,
    /// Seconds per stage, in their order.
    pub stages: Vec<StageTime>,
    /// Seconds that `total` holds beyond its stages.
    pub unattributed: Option<f64>,
}

/// Seconds of a stage.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct StageTime {
    pub name: String,
    pub seconds: f64,
}

/// The stage that explains most of an iteration's slowness.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Blame {
    pub name: String,
    pub seconds: f64,
    /// In the median of the run.
    pub median: f64,
}

impl From<&aggregator::IterationRow> for IterationSummary {
    fn from(row: &aggregator::IterationRow) -> Self {
        let stages = row.stages.iter();
        Self {
            number: row.number,
            episode: row.episode,
            step: row.step,
            warm_up: row.warm_up,
            outcome: row.outcome.clone(),
            reason: row.reason.clone(),
            started: time(row.started),
            total: row.total,
            factor: row.factor,
            blame: row.blame.as_ref().map(|blame| Blame {
                name: blame.stage.to_string(),
                seconds: blame.value,
                median: blame.median,
            }),
            stages: stages
                .map(|(name, seconds)| StageTime { name: name.to_string(), seconds: *seconds })
                .collect(),
            unattributed: row.unattributed,
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
    /// Place among the slowest, from 1.
    pub rank: Option<u64>,
    pub previous: Option<u64>,
    pub next: Option<u64>,
    /// The whole run, for comparison.
    pub run_figures: Vec<NodeFigures>,
}

impl TryFrom<&aggregator::IterationDetail> for Iteration {
    type Error = serde_json::Error;
    fn try_from(detail: &aggregator::IterationDetail) -> Result<Self, serde_json::Error> {
        Ok(Self {
            summary: IterationSummary::from(&detail.row),
            tree: serde_json::to_value(&detail.tree)?,
            hosts: detail.hosts.iter().map(|host| host.as_ref().map(ToString::to_string)).collect(),
            rank: detail.rank,
            previous: detail.previous,
            next: detail.next,
            run_figures: NodeFigures::all(&detail.run_figures),
        })
    }
}
