//! Schema of comparisons and experiments.

use peernet_analysis::deadline::Misses;
use peernet_store::{self as store, QuantityStatistics};
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::schema::time;
use crate::view::compare;

/// Experiments, the one with the newest run first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct ExperimentList {
    pub experiments: Vec<Experiment>,
}

/// Runs of one execution of an experiment file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Experiment {
    /// Id of the experiment; equal for all runs of one execution.
    pub id: String,
    pub name: String,
    /// Number of runs that started.
    pub runs: u64,
    /// Number of these runs that have not ended.
    pub open: u64,
    /// Number of the first run.
    #[serde(rename = "oldest")]
    pub first_run: i64,
    /// Number of the newest run.
    #[serde(rename = "newest")]
    pub last_run: i64,
    /// Start of the first run, on its edge's wall clock.
    pub started: String,
}

impl From<&store::ExperimentSummary> for Experiment {
    fn from(summary: &store::ExperimentSummary) -> Self {
        let store::ExperimentSummary { id, name, runs, open, first_run, last_run, started } = summary.clone();
        Self { id, name, runs, open, first_run, last_run, started: time(started) }
    }
}

/// Comparison of configurations; successful iterations only, warm-up left out.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Comparison {
    /// Id of the requested experiment.
    pub experiment: Option<String>,
    /// Names of the settings in which the configurations differ.
    pub axes: Vec<String>,
    pub configurations: Vec<Configuration>,
    /// Further settings in which the configurations differ, and settings that the experiment declares with one value for all configurations.
    pub settings: Vec<Setting>,
    /// Letter of the configuration with the lowest mean of `total`, or of `stages-total` if an iteration has no `total`; null if there is
    /// nothing to compare. Configurations with an echo model are excluded if others run a real model.
    pub best: Option<String>,
    /// Letters of the configurations whose mean is not significantly larger than the lowest.
    pub ties: Vec<String>,
    /// Letter of the baseline.
    pub baseline: Option<String>,
    /// Differences between each other configuration and the baseline, stage by stage, if the interval is known.
    pub differences: Vec<Difference>,
    /// Caveats about the figures, as sentences; for example that starts were skipped.
    pub doubts: Vec<String>,
    /// Excluded runs of the experiment: runs that were not measured to their end by all edges, and runs that were measured again.
    pub left_out: Vec<LeftOut>,
    /// `true` if there are more runs than the maximum, and the further runs are not compared.
    pub cut: bool,
}

/// A run that is excluded from the comparison.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct LeftOut {
    /// Number of the run.
    pub run: i64,
    /// Reason of the exclusion: how the run ended, or the number of the run that replaces it.
    pub why: String,
}

/// A configuration with all of its runs combined.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Configuration {
    /// `A`, `B` and so on, in the order of the list.
    pub letter: String,
    /// Unique name, made of the settings in which this configuration differs from the others.
    pub name: String,
    /// Value of the configuration on each axis.
    pub values: Vec<String>,
    /// Numbers of its runs.
    pub runs: Vec<i64>,
    /// Number of starts that were due, without warm-up; in a closed loop the number of iterations.
    pub starts: u64,
    /// Number of these starts that were skipped because the pipeline was too far behind its schedule.
    pub skipped_starts: u64,
    /// Deadline of an iteration, seconds; null without a deadline, and if its runs have different deadlines.
    pub deadline_s: Option<f64>,
    /// Share of iterations that took longer than the deadline or failed, 0 to 1, without warm-up; null without a deadline.
    pub miss_rate: Option<f64>,
    pub stages: Vec<ComparedStage>,
}

/// Statistics of one node name over all runs of a configuration together, in its SI unit. Counts, means, deviations and extremes are
/// exact; quantiles are within 1 % of the quantiles of all iterations.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ComparedStage {
    pub name: String,
    /// Unit: `s`, `B`, `bit/s` or user-defined.
    pub unit: String,
    #[serde(flatten)]
    pub statistics: QuantityStatistics,
}

/// A setting with its value in each configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Setting {
    pub name: String,
    /// Values in the order of `configurations`.
    pub values: Vec<String>,
}

/// A difference of two means, seconds.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Difference {
    /// Letter of the configuration that is compared with the baseline.
    pub configuration: String,
    pub name: String,
    pub value: f64,
    /// Lower and upper end of the 95 % interval.
    pub interval: [f64; 2],
    /// `true` if the interval does not contain zero.
    pub certain: bool,
}

impl Comparison {
    pub(crate) fn new(comparison: &compare::Comparison, differences: &compare::Differences) -> Self {
        let stage = |stage: &store::StageStatistics| ComparedStage {
            name: stage.stage.to_string(),
            unit: stage.unit.clone(),
            statistics: stage.statistics,
        };
        let configuration = |(index, one): (usize, &compare::Configuration)| Configuration {
            letter: configuration_letter(index),
            name: one.name.clone(),
            values: one.values.clone(),
            runs: one.runs.iter().map(|run| run.number).collect(),
            starts: one.starts().total(),
            skipped_starts: one.starts().skipped,
            deadline_s: one.deadline_s(),
            miss_rate: one.misses().and_then(Misses::rate),
            stages: one.stages.iter().map(stage).collect(),
        };
        let left_out =
            |excluded: &compare::ExcludedRun| LeftOut { run: excluded.run, why: excluded.why.clone() };
        let differences_to_baseline = differences.others.iter().flat_map(|(index, stages)| {
            let with_interval = |stage: &compare::StageDifference| {
                let mean_difference = stage.mean_difference?;
                Some(Difference {
                    configuration: configuration_letter(*index),
                    name: stage.name.to_string(),
                    value: mean_difference.value,
                    interval: mean_difference.interval?.into(),
                    certain: mean_difference.is_distinct()?,
                })
            };
            stages.iter().filter_map(with_interval).collect::<Vec<_>>()
        });
        let setting = |one: &compare::Setting| Setting { name: one.name.clone(), values: one.values.clone() };
        let ranking = differences.ranking.as_ref();
        Self {
            experiment: comparison.experiment.as_ref().map(|(_, id)| id.clone()),
            axes: comparison.axes.clone(),
            settings: comparison.settings.iter().map(setting).collect(),
            configurations: comparison.configurations.iter().enumerate().map(configuration).collect(),
            best: ranking.map(|ranking| configuration_letter(ranking.best)),
            ties: ranking
                .map(|ranking| ranking.ties().into_iter().map(configuration_letter).collect())
                .unwrap_or_default(),
            baseline: (!comparison.configurations.is_empty())
                .then(|| configuration_letter(differences.baseline)),
            differences: differences_to_baseline.collect(),
            doubts: compare::caveats(comparison).into_iter().map(|(_, text)| text).collect(),
            left_out: comparison.left_out.iter().map(left_out).collect(),
            cut: comparison.is_truncated,
        }
    }
}

/// Returns the letter of a configuration: `A` to `Z`, then `AA`.
fn configuration_letter(mut index: usize) -> String {
    let mut text = String::new();
    loop {
        text.insert(0, char::from(b'A' + (index % 26) as u8));
        index = match (index / 26).checked_sub(1) {
            Some(rest) => rest,
            None => return text,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::configuration_letter;

    #[test]
    fn configurations_have_letters() {
        let letters: Vec<String> = [0, 1, 25, 26, 51, 52, 701, 702].map(configuration_letter).to_vec();
        assert_eq!(letters, ["A", "B", "Z", "AA", "AZ", "BA", "ZZ", "AAA"]);
    }
}
