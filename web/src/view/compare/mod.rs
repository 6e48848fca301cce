//! Comparison of runs. It reads roll-ups and a bounded number of rows, so that its cost does not depend on the length
//! of a run.

#[cfg(test)]
mod agreement;
mod caveats;
mod choice;
mod differences;
mod differing;
mod distributions;
pub(crate) mod gather;
pub(crate) mod lengths;
mod median;
mod names;
mod pairwise;
mod payload;
mod pictures;
mod qualities;
mod series;
mod spread;
mod table;
#[cfg(test)]
pub(crate) mod tests;
mod title;
mod users;

pub(crate) use caveats::{caveats, commands, unknown_labels};
pub(crate) use differences::{Differences, RunMeans, StageDifference, run_means};
pub(crate) use distributions::{Address, Distributions, distributions};
pub(crate) use gather::{CompareSelection, MAX_EXPERIMENT_RUNS, load_comparison};
pub(crate) use lengths::{Lengths, answers, lengths};
pub(crate) use pairwise::{PairwiseRow, pairwise};
pub(crate) use payload::{PayloadPlots, payload};
pub(crate) use pictures::{Axes, ModelByPlace, StackRow, models_by_place, stacks};
pub(crate) use qualities::{QualityPlot, qualities};
pub(crate) use series::{OverTime, over_time, run_time_series};
pub(crate) use spread::{BoxRow, boxes};
pub(crate) use table::{DifferenceRow, Table};
pub(crate) use title::title;
pub(crate) use users::{UsersTable, measured_users, users};

use std::collections::HashMap;
use std::sync::Arc;

use peernet_analysis::accuracy::UnknownLabels;
use peernet_analysis::concurrent_edges::concurrent_groups;
use peernet_analysis::deadline::Misses;
use peernet_analysis::total_column::TotalColumn;
use peernet_analysis::trust::{ReplayedLatencies, Report, Starts};
use peernet_statistics::Summary;
use peernet_statistics::number::column_decimals;
use peernet_store::{DelayAccuracy, MergeableStatistics, QuantityStatistics, RunSummary, StageStatistics};

use crate::error::WebError;

/// Configurations to compare.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Comparison {
    /// Name and id of the experiment, if one was selected.
    pub experiment: Option<(String, String)>,
    /// Names of the settings in which the configurations differ.
    pub axes: Vec<String>,
    /// Further settings in which configurations differ, and settings that an experiment declares
    /// with one value for all configurations.
    pub settings: Vec<Setting>,
    /// Names of further settings that differ but are too long for a table, such as hashes, paths and lists.
    pub long_settings: Vec<String>,
    /// Latency by which the configurations are compared.
    pub total_column: TotalColumn,
    /// Configurations. Those of an experiment are in the order of its file. Selected runs are in the requested order.
    pub configurations: Vec<Configuration>,
    /// All stored statistics of each run, by its number.
    pub statistics_by_run: HashMap<i64, Arc<MergeableStatistics>>,
    /// Report on whether a run can be published, by the number of the run.
    pub trust_by_run: HashMap<i64, Report>,
    /// Distribution from which the latencies of a run are drawn, by the number of the run. Runs with measured latencies
    /// are absent.
    pub replayed_by_run: HashMap<i64, ReplayedLatencies>,
    /// Samples whose label is not a class of the model, by the number of the run. Runs without such samples are absent.
    pub unknown_labels_by_run: HashMap<i64, UnknownLabels>,
    /// Excluded runs of the experiment, oldest first.
    pub left_out: Vec<ExcludedRun>,
    /// `true` if the experiment has more runs than are compared.
    pub is_truncated: bool,
}

/// An excluded run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ExcludedRun {
    /// Number of the run.
    pub run: i64,
    /// The reason.
    pub why: String,
}

/// A setting with its value in each configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Setting {
    pub name: String,
    pub values: Vec<String>,
}

/// Returns the latency by which configurations are compared.
pub(super) fn total_column(configurations: &[Configuration]) -> TotalColumn {
    let count = |column: TotalColumn| {
        configurations
            .iter()
            .filter_map(|configuration| configuration.statistics(column.name()))
            .map(|statistics| statistics.count)
            .sum()
    };
    let iterations = configurations.iter().map(Configuration::iterations).sum();
    TotalColumn::from_counts(iterations, count(TotalColumn::Measured), count(TotalColumn::SumOfStages))
}

/// Runs of one configuration, combined.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Configuration {
    /// Unique name: what distinguishes the configuration from the others, in words.
    pub name: String,
    /// Value of the configuration on each axis.
    pub values: Vec<String>,
    /// Runs, oldest first.
    pub runs: Vec<RunSummary>,
    /// Statistics of each stage, of all its runs together.
    pub stages: Vec<StageStatistics>,
    /// Accuracy of the one-way delays.
    pub bounds: Vec<DelayAccuracy>,
    /// All stored statistics of its runs together.
    pub mergeable: Arc<MergeableStatistics>,
    /// `false` if the model of at least one run is an echo model, which only returns its input.
    pub model_computes: bool,
}

impl Configuration {
    /// Returns the statistics of a stage or another measured quantity by its name.
    pub(crate) fn statistics(&self, name: &str) -> Option<&QuantityStatistics> {
        self.stages.iter().find(|stage| stage.stage == *name).map(|stage| &stage.statistics)
    }

    /// Returns the summary of a node's values in all runs together, in the SI unit of the node.
    pub(crate) fn summary(&self, name: &str) -> Option<&Summary> {
        self.mergeable.summary(name)
    }

    /// Returns the runs in groups: the runs of edges that measured at the same time are one group.
    pub(crate) fn concurrent_runs(&self) -> Vec<Vec<&RunSummary>> {
        concurrent_groups(&self.runs, |run| run.experiment.as_ref(), |run| &run.host_name)
    }

    /// Returns the number of successful iterations after the warm-up.
    pub(crate) fn iterations(&self) -> u64 {
        self.runs.iter().map(|run| run.counts.ok).sum()
    }

    /// Returns the counts of executed and skipped starts of all runs.
    pub(crate) fn starts(&self) -> Starts {
        Starts::sum(self.runs.iter().map(Starts::from))
    }

    /// Returns the number of iterations that missed their deadline; `None` if no run has a deadline.
    pub(crate) fn misses(&self) -> Option<Misses> {
        Misses::sum(self.runs.iter().filter_map(|run| run.misses))
    }

    /// Returns the deadline that all runs have, seconds; `None` if their deadlines differ, or a run
    /// has none.
    pub(crate) fn deadline_s(&self) -> Option<f64> {
        let mut deadlines = self.runs.iter().map(|run| run.deadline_s);
        let first = deadlines.next()??;
        deadlines.all(|deadline| deadline == Some(first)).then_some(first)
    }
}

impl Comparison {
    /// Returns the statistics of the latency by which configurations are compared, seconds. For a pipeline that only
    /// senses, these are the statistics of `sensing`.
    pub(crate) fn total<'a>(&self, configuration: &'a Configuration) -> Option<&'a QuantityStatistics> {
        self.total_column.latency_names().iter().find_map(|name| configuration.statistics(name))
    }

    /// Returns the number of decimals of the means in one column, ms. Pictures and tables of the page show equally many
    /// decimals.
    pub(crate) fn mean_decimals(&self, column: &str) -> usize {
        let statistics = self.configurations.iter().filter_map(|one| one.statistics(column));
        column_decimals(statistics.map(|statistics| statistics.std))
    }

    /// Returns the index of the chosen baseline: the configuration of the run with the number
    /// `run`; `None` if no number is given.
    ///
    /// # Errors
    /// Returns an error when the run is not one of the compared runs.
    pub(crate) fn baseline(&self, run: Option<&str>) -> Result<Option<usize>, WebError> {
        let Some(text) = run.filter(|text| !text.is_empty()) else { return Ok(None) };
        let index_of = |number: i64| {
            self.configurations.iter().position(|one| one.runs.iter().any(|run| run.number == number))
        };
        text.trim_start_matches('#').parse().ok().and_then(index_of).map(Some).ok_or_else(|| {
            WebError::BadRequest(format!(
                "query parameter baseline: {text:?} is not the number of a compared run"
            ))
        })
    }

    /// Returns the summary of a node's values in the run with the number `run`.
    pub(crate) fn summary(&self, run: i64, name: &str) -> Option<&Summary> {
        self.statistics_by_run.get(&run)?.summary(name)
    }

    /// Returns the number of compared runs. The stored runs of edges that measured at the same time in an experiment
    /// count as one run, as in the tables of result folders.
    pub(crate) fn run_count(&self) -> usize {
        match self.experiment {
            Some(_) => self.configurations.iter().map(|one| one.concurrent_runs().len()).sum(),
            None => self.runs().count(),
        }
    }

    /// Returns the stored runs of all edges that measured at the same time as the edge of `run`. If no experiment is
    /// compared, returns only `run`.
    pub(crate) fn edges_of_run<'a>(
        &self,
        configuration: &'a Configuration,
        run: &'a RunSummary,
    ) -> Vec<&'a RunSummary> {
        let has_run = |group: &Vec<&RunSummary>| group.iter().any(|edge| edge.number == run.number);
        let groups = self.experiment.as_ref().map(|_| configuration.concurrent_runs());
        groups.and_then(|groups| groups.into_iter().find(has_run)).unwrap_or_else(|| vec![run])
    }

    /// Returns all stored runs, configuration by configuration.
    pub(crate) fn runs(&self) -> impl Iterator<Item = &RunSummary> {
        self.configurations.iter().flat_map(|one| &one.runs)
    }
}
