//! Runs side by side, and experiments.

use peernet_logger::Name;
use peernet_report::batches;
use peernet_store::{self as store, Figures};
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::schema::time;
use crate::view::compare;

/// Experiments, the one with the newest run first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct ExperimentList {
    pub experiments: Vec<Experiment>,
}

/// Runs that were declared together.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Experiment {
    /// The same for all runs of one execution.
    pub id: String,
    pub name: String,
    /// Runs that began.
    pub runs: u64,
    /// Of them those that have not ended.
    pub open: u64,
    /// Number of its first run.
    pub oldest: i64,
    /// Number of its newest run.
    pub newest: i64,
    /// When the first began, on its edge's wall clock.
    pub started: String,
}

impl From<&store::ExperimentSummary> for Experiment {
    fn from(known: &store::ExperimentSummary) -> Self {
        let store::ExperimentSummary { id, name, runs, open, oldest, newest, started } = known.clone();
        Self { id, name, runs, open, oldest, newest, started: time(started) }
    }
}

/// Configurations side by side; successful iterations only, warm-up left out.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Comparison {
    /// Id of the experiment that was asked for.
    pub experiment: Option<String>,
    /// What the configurations differ in.
    pub axes: Vec<String>,
    pub configurations: Vec<Configuration>,
    /// Letter of the configuration with the lowest mean of `total`; null where there is nothing to compare.
    pub best: Option<String>,
    /// The second configuration less the first, where there are exactly two.
    pub differences: Vec<Difference>,
    /// What keeps the figures from being taken as they stand, in sentences: starts that were skipped.
    pub doubts: Vec<String>,
    /// Runs of the experiment that are not compared: those that were not finished, and those that were done again.
    pub left_out: Vec<LeftOut>,
    /// Whether there were more runs than are compared.
    pub cut: bool,
}

/// A run that is not compared.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct LeftOut {
    /// Its number.
    pub run: i64,
    /// How it ended, or as which one it was done again.
    pub why: String,
}

/// Runs of one configuration, taken together.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Configuration {
    /// What the dashboard calls it.
    pub letter: String,
    /// Its value on each axis.
    pub values: Vec<String>,
    /// Numbers of its runs.
    pub runs: Vec<i64>,
    /// Starts that came due, warm-up left out; in a closed loop as many as there are iterations.
    pub starts: u64,
    /// Of them those that were skipped because the pipeline was too far behind.
    pub skipped_starts: u64,
    pub stages: Vec<ComparedStage>,
}

/// Statistics of one node name over all runs of the configuration together, in its SI unit: counts, means, deviations and
/// extremes are exact, quantiles within 1 % of those of all their iterations.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ComparedStage {
    pub name: String,
    /// `s`, `B`, `bit/s` or the user's own.
    pub unit: String,
    #[serde(flatten)]
    pub figures: Figures,
}

/// A difference of two means, seconds.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Difference {
    pub name: String,
    pub value: f64,
    /// Lower and upper end of the 95 % interval.
    pub interval: [f64; 2],
    /// Whether zero lies outside the interval.
    pub certain: bool,
}

impl Comparison {
    pub(crate) fn new(
        comparison: &compare::Comparison,
        differences: &[(Name, Option<batches::Difference>, compare::Changed)],
    ) -> Self {
        let stage = |stage: &store::StageStatistics| ComparedStage {
            name: stage.stage.to_string(),
            unit: stage.unit.clone(),
            figures: stage.figures,
        };
        let configuration = |one: &compare::Configuration| Configuration {
            letter: one.letter.clone(),
            values: one.values.clone(),
            runs: one.runs.iter().map(|run| run.number).collect(),
            starts: one.starts().all(),
            skipped_starts: one.starts().skipped,
            stages: one.stages.iter().map(stage).collect(),
        };
        let left_out = |one: &compare::LeftOut| LeftOut { run: one.run, why: one.why.clone() };
        let known = differences.iter().filter_map(|(name, found, _)| Some((name, (*found)?)));
        Self {
            experiment: comparison.experiment.as_ref().map(|(_, id)| id.clone()),
            axes: comparison.axes.clone(),
            configurations: comparison.configurations.iter().map(configuration).collect(),
            best: comparison.best().map(|at| comparison.configurations[at].letter.clone()),
            differences: known
                .map(|(name, found)| Difference {
                    name: name.to_string(),
                    value: found.value,
                    interval: [found.interval.0, found.interval.1],
                    certain: found.is_certain(),
                })
                .collect(),
            doubts: compare::doubts(comparison),
            left_out: comparison.left_out.iter().map(left_out).collect(),
            cut: comparison.cut,
        }
    }
}
