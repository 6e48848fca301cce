//! Differences of the configurations' means, and their significance.

use std::collections::HashMap;

use futures::{StreamExt, TryStreamExt};
use peernet_analysis::compare::{
    ConfigurationTotal, Difference, MeanEstimate, Ranking, STAGES, default_baseline, find_unranked,
};
use peernet_analysis::total_column::TotalColumn;
use peernet_logger::Name;
use peernet_store::{RunSummary, StageMeans, Store};

use super::{Comparison, Configuration};
use crate::error::WebError;

/// Maximum number of buckets per run that are read.
const MAX_BUCKETS: usize = 120;
/// Number of runs that are read concurrently.
pub(super) const CONCURRENT_READS: usize = 4;

/// Means of the stages of each run, by its number.
pub(crate) type RunMeans = HashMap<i64, Vec<StageMeans>>;

/// Returns the nodes whose times are compared: the stages, their sum, the total and further times.
pub(super) fn compared_stages() -> Vec<Name> {
    STAGES.iter().copied().map(Name::from_static).collect()
}

/// Reads the means of the stages over the time of each run.
///
/// # Errors
/// Returns an error when the store cannot be read.
pub(crate) async fn run_means(store: &Store, comparison: &Comparison) -> Result<RunMeans, WebError> {
    let names = &compared_stages();
    let runs: Vec<i64> = comparison.runs().map(|run| run.number).collect();
    let read = |run| async move { Ok((run, store.stage_means(run, names, MAX_BUCKETS).await?)) };
    futures::stream::iter(runs).map(read).buffered(CONCURRENT_READS).try_collect().await
}

/// Differences between the baseline and the other configurations.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Differences {
    /// Index of the baseline.
    pub baseline: usize,
    /// For each configuration except the baseline: its index, and its stages in their order, without unmeasured stages.
    pub others: Vec<(usize, Vec<StageDifference>)>,
    /// Latency by which the configurations are ranked.
    pub total_column: TotalColumn,
    /// Ranking by mean total; `None` if fewer than two configurations can be ranked, or if none of these has a total.
    pub ranking: Option<Ranking>,
    /// Indexes of the configurations that are not ranked, because their model computes nothing.
    pub unranked: Vec<usize>,
}

/// Difference of one stage between the baseline and another configuration, seconds.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StageDifference {
    pub name: Name,
    /// Mean of the baseline and of the other configuration; `None` if unknown.
    pub means: (Option<f64>, Option<f64>),
    /// Other configuration minus baseline; `None` unless both means are known.
    pub mean_difference: Option<Difference>,
}

impl StageDifference {
    /// Returns whether the difference is significant; `None` if that cannot be determined.
    pub(crate) fn is_distinct(&self) -> Option<bool> {
        self.mean_difference.and_then(|mean_difference| mean_difference.is_distinct())
    }
}

impl Differences {
    /// Compares all configurations with the configuration at index `baseline`. Without an index, the baseline is the
    /// [default](default_baseline), as in `peernet compare`.
    pub(crate) fn of(comparison: &Comparison, means: &RunMeans, baseline: impl Into<Option<usize>>) -> Self {
        let names = compared_stages();
        let all = &comparison.configurations;
        let estimate = |configuration: &Configuration, name: &Name| {
            // A run without values of the stage is left out. A run with values is included even if retention deleted
            // its buckets.
            let has_values = |run: &&RunSummary| comparison.summary(run.number, name).is_some();
            let runs =
                configuration.runs.iter().filter(has_values).map(|run| buckets(means, run.number, name));
            Some(MeanEstimate::from_buckets(configuration.statistics(name)?.mean, &runs.collect::<Vec<_>>()))
        };
        let estimates: Vec<Vec<Option<MeanEstimate>>> =
            all.iter().map(|one| names.iter().map(|name| estimate(one, name)).collect()).collect();
        let total_column = comparison.total_column;
        let total = |(one, estimates): (&Configuration, &Vec<Option<MeanEstimate>>)| {
            let name_and_estimate =
                names.iter().zip(estimates).find(|(name, _)| **name == *total_column.name());
            ConfigurationTotal {
                model_computes: one.model_computes,
                mean: name_and_estimate.and_then(|(_, estimate)| estimate.clone()),
            }
        };
        let totals: Vec<ConfigurationTotal> = all.iter().zip(&estimates).map(total).collect();
        let ranking = Ranking::new(&totals);
        let default = || default_baseline(ranking.as_ref().map(|ranking| ranking.best));
        let baseline = baseline.into().unwrap_or_else(default);
        let stages = |index: usize| {
            let mean =
                |index: usize, name: &Name| all[index].statistics(name).map(|statistics| statistics.mean);
            let stage = |(stage_index, name): (usize, &Name)| {
                let means = (mean(baseline, name), mean(index, name));
                (means != (None, None)).then_some(())?;
                let estimates =
                    estimates[baseline][stage_index].as_ref().zip(estimates[index][stage_index].as_ref());
                let mean_difference =
                    estimates.map(|(first, second)| Difference::between_means(first, second));
                Some(StageDifference { name: name.clone(), means, mean_difference })
            };
            (index, names.iter().enumerate().filter_map(stage).collect())
        };
        let others = (0..all.len()).filter(|index| *index != baseline).map(stages).collect();
        Self { baseline, others, total_column, ranking, unranked: find_unranked(&totals) }
    }

    /// Returns the difference between the mean totals of a configuration and of the baseline; `None` for the baseline
    /// itself, and without totals.
    pub(crate) fn total(&self, index: usize) -> Option<&StageDifference> {
        let (_, stages) = self.others.iter().find(|(other, _)| *other == index)?;
        stages.iter().find(|stage| stage.name == *self.total_column.name())
    }
}

/// Returns the count and the mean of each bucket of a stage of a run; empty if the buckets are not stored.
fn buckets(means: &RunMeans, run: i64, name: &Name) -> Vec<(u64, f64)> {
    let of_run = means.get(&run).into_iter().flatten().filter(|stage| stage.stage == *name);
    of_run.flat_map(|stage| stage.buckets.iter().map(|bucket| (bucket.count, bucket.mean))).collect()
}
