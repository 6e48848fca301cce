//! Loading of the runs of a comparison, and of the settings in which they differ.

use std::cmp::Ordering;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use futures::{StreamExt, TryStreamExt};
use peernet_analysis::accuracy::UnknownLabels;
use peernet_analysis::compare::{Column, compare_positions, group_by_labels, model_computes};
use peernet_analysis::run_selection::{Candidate, Exclusion, exclusions};
use peernet_analysis::trust::{ReplayedLatencies, Report};
use peernet_store::{MergeableStatistics, RunDetail, RunStatistics, RunSummary, Store};
use peernet_stream::ExperimentPosition;

use super::differences::CONCURRENT_READS;
use super::differing::DifferingSettings;
use super::names::configuration_names;
use super::{Comparison, Configuration, ExcludedRun, Setting, total_column};
use crate::error::WebError;

/// Maximum number of runs that a query may name.
pub(crate) const MAX_SELECTED_RUNS: usize = 12;
/// Maximum number of runs of an experiment that are compared.
pub(crate) const MAX_EXPERIMENT_RUNS: u32 = 200;

/// Selection of the runs to compare, from the query parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum CompareSelection {
    /// These runs; each is a separate configuration.
    Runs(Vec<i64>),
    /// All valid runs of an experiment. The repeats of a configuration are combined.
    Experiment(String),
}

impl CompareSelection {
    /// Parses `runs=1,2&runs=3` or `experiment=ID`. Returns `None` without a selection.
    ///
    /// # Errors
    /// Returns an error when a number is invalid, there are too many numbers, both parameters are
    /// given, or there is any other parameter. The error about another parameter contains
    /// `parameters`, a list of the valid ones.
    pub(crate) fn parse(pairs: &[(String, String)], parameters: &str) -> Result<Option<Self>, WebError> {
        let bad_request = |text: String| Err(WebError::BadRequest(format!("query parameter {text}")));
        let (mut runs, mut experiment) = (Vec::<i64>::new(), None);
        for (name, value) in pairs {
            match name.as_str() {
                "runs" => {
                    for text in value.split(',').map(str::trim).filter(|text| !text.is_empty()) {
                        let Ok(number) = text.trim_start_matches('#').parse() else {
                            return bad_request(format!("runs: {text:?} is not the number of a run"));
                        };
                        if !runs.contains(&number) {
                            runs.push(number);
                        }
                    }
                }
                "experiment" if !value.is_empty() => experiment = Some(value.clone()),
                "experiment" => {}
                other => return bad_request(format!("{other}: unknown parameter; valid are {parameters}")),
            }
        }
        match (runs.len(), experiment) {
            (0, None) => Ok(None),
            (0, Some(id)) => Ok(Some(Self::Experiment(id))),
            (_, Some(_)) => bad_request("experiment: give either runs or an experiment".to_owned()),
            (many, None) if many > MAX_SELECTED_RUNS => bad_request(format!(
                "runs: {many} runs are named, but at most {MAX_SELECTED_RUNS} can be compared"
            )),
            (_, None) => Ok(Some(Self::Runs(runs))),
        }
    }
}

/// Loads a comparison: the statistics of all runs, from their roll-ups.
///
/// The sketches of all runs are in memory at the same time. A sketch takes eight bytes for each step of 2 % from the
/// smallest to the largest value. This is 3 kB if the two values differ by a factor of a thousand. The maximum number
/// of runs takes 17 MB if each run has 30 sketches, and the configurations take at most as much again. A sketch has a
/// maximum size, so the worst case is ten times these 17 MB.
///
/// # Errors
/// Returns an error when a run or the experiment is not stored, or the store cannot be read.
pub(crate) async fn load_comparison(
    store: &Store,
    selection: &CompareSelection,
) -> Result<Comparison, WebError> {
    let (experiment, details, left_out, is_truncated) = match selection {
        CompareSelection::Runs(numbers) => {
            let mut details = Vec::with_capacity(numbers.len());
            for number in numbers {
                let run = store.run(*number).await?;
                details.push(run.ok_or_else(|| WebError::NotFound(format!("no run #{number} is stored")))?);
            }
            (None, details, Vec::new(), false)
        }
        CompareSelection::Experiment(id) => {
            // One run more than the limit shows whether the experiment has more runs.
            let mut runs = store.runs_of_experiment(id, MAX_EXPERIMENT_RUNS + 1).await?;
            let is_truncated = runs.len() > MAX_EXPERIMENT_RUNS as usize;
            runs.truncate(MAX_EXPERIMENT_RUNS as usize);
            let experiment = runs.first().and_then(|run| run.experiment.clone());
            let Some(experiment) = experiment else {
                return Err(WebError::NotFound(format!(
                    "no run of an experiment with the id {id} is stored; GET /api/v1/runs shows the id of each run's experiment"
                )));
            };
            let (runs, left_out) = select_runs(runs);
            // These details have no facts. The settings of an experiment need no facts, and `JudgedRuns` loads the
            // details with facts below.
            let details = runs.into_iter().map(RunDetail::from).collect();
            (Some((experiment.name, experiment.id)), details, left_out, is_truncated)
        }
    };
    let numbers: Vec<i64> = details.iter().map(|detail| detail.summary.number).collect();
    let statistics = store.statistics(&numbers).await?;
    let JudgedRuns { trust_by_run, replayed_by_run, unknown_labels_by_run, echo_runs } =
        JudgedRuns::load(store, &numbers).await?;
    let DifferingSettings { axes, axis_values, other_settings, names_of_long_settings } =
        if experiment.is_some() {
            DifferingSettings::of_experiment(&details)
        } else {
            DifferingSettings::of_runs(&details)
        };
    let statistics_by_run: HashMap<i64, Arc<MergeableStatistics>> = numbers
        .iter()
        .zip(&statistics)
        .map(|(run, statistics)| (*run, Arc::clone(&statistics.mergeable)))
        .collect();
    // Runs that are chosen one by one are separate configurations, even with equal labels.
    let run_groups = match experiment {
        Some(_) => group_by_labels(&axis_values),
        None => (0..details.len()).map(|run| vec![run]).collect(),
    };
    // Each run is moved into its group and not copied, because its statistics are large.
    let mut loaded: Vec<_> =
        details.into_iter().map(|detail| detail.summary).zip(statistics).map(Some).collect();
    let group = |indexes: Vec<usize>| {
        let (runs, statistics) = indexes.iter().filter_map(|index| loaded[*index].take()).unzip();
        let settings = other_settings.iter().map(|column| column.labels[indexes[0]].clone()).collect();
        Group { values: axis_values[indexes[0]].clone(), settings, runs, statistics }
    };
    let mut groups: Vec<Group> = run_groups.into_iter().map(group).collect();
    if experiment.is_some() {
        let order = |a: &Group, b: &Group| Some(compare_positions(a.position()?, b.position()?));
        groups.sort_by(|a, b| order(a, b).unwrap_or(Ordering::Equal));
    }
    let setting = |(index, column): (usize, &Column)| Setting {
        name: column.axis.clone(),
        values: groups.iter().map(|group| group.settings[index].clone()).collect(),
    };
    let settings = other_settings.iter().enumerate().map(setting).collect();
    let names = configuration_names(
        &axes,
        groups.iter().map(|group| (group.values.as_slice(), group.runs.as_slice())),
    );
    let configurations = groups.into_iter().zip(names).map(|(group, name)| {
        let RunStatistics { stages, bounds, mergeable } = RunStatistics::merged(&group.statistics);
        let model_computes = group.runs.iter().all(|run| !echo_runs.contains(&run.number));
        Configuration {
            name,
            values: group.values,
            runs: group.runs,
            stages,
            bounds,
            mergeable,
            model_computes,
        }
    });
    let configurations: Vec<Configuration> = configurations.collect();
    Ok(Comparison {
        experiment,
        axes,
        settings,
        long_settings: names_of_long_settings,
        total_column: total_column(&configurations),
        configurations,
        statistics_by_run,
        trust_by_run,
        replayed_by_run,
        unknown_labels_by_run,
        left_out,
        is_truncated,
    })
}

/// Facts and reports from the details of the runs, by number of the run. A run that was deleted in
/// the meantime is absent.
struct JudgedRuns {
    /// Report on whether the run can be published.
    trust_by_run: HashMap<i64, Report>,
    /// Replayed latencies of the runs that have them.
    replayed_by_run: HashMap<i64, ReplayedLatencies>,
    /// Unknown labels of the runs that have them.
    unknown_labels_by_run: HashMap<i64, UnknownLabels>,
    /// Runs whose model only returns its input.
    echo_runs: HashSet<i64>,
}

impl JudgedRuns {
    async fn load(store: &Store, runs: &[i64]) -> Result<Self, WebError> {
        let judge = |run: i64| async move {
            let Some(detail) = store.run(run).await? else { return Ok::<_, WebError>(None) };
            let input = store.trust_input(&detail).await?;
            let report = Report::new(&input);
            let replayed = input.replayed_latencies();
            Ok(Some((run, report, replayed, input.unknown_labels, model_computes(&detail.facts))))
        };
        let judged = futures::stream::iter(runs.iter().copied()).map(judge).buffered(CONCURRENT_READS);
        let judged: Vec<_> = judged.try_filter_map(|run| async move { Ok(run) }).try_collect().await?;
        Ok(Self {
            replayed_by_run: judged
                .iter()
                .filter_map(|(run, _, replayed, ..)| Some((*run, replayed.clone()?)))
                .collect(),
            unknown_labels_by_run: judged
                .iter()
                .filter_map(|(run, .., unknown, _)| Some((*run, unknown.clone()?)))
                .collect(),
            echo_runs: judged.iter().filter(|(.., computes)| !computes).map(|(run, ..)| *run).collect(),
            trust_by_run: judged.into_iter().map(|(run, report, ..)| (run, report)).collect(),
        })
    }
}

/// Splits the runs of an experiment into compared runs, in their order, and excluded runs.
fn select_runs(runs: Vec<RunSummary>) -> (Vec<RunSummary>, Vec<ExcludedRun>) {
    let exclusion_by_run = exclusions(&runs.iter().map(Candidate::from).collect::<Vec<_>>());
    let name = |index: usize| format!("#{}", runs[index].number);
    let left_out = |(run, why): (&RunSummary, &Option<_>)| {
        let why: &Exclusion = why.as_ref()?;
        Some(ExcludedRun { run: run.number, why: why.describe(name) })
    };
    let left_out = runs.iter().zip(&exclusion_by_run).filter_map(left_out).collect();
    let selected =
        runs.into_iter().zip(exclusion_by_run).filter(|(_, why)| why.is_none()).map(|(run, _)| run);
    (selected.collect(), left_out)
}

/// Runs of one configuration.
struct Group {
    /// Value on each axis.
    values: Vec<String>,
    /// Value of each further setting.
    settings: Vec<String>,
    runs: Vec<RunSummary>,
    statistics: Vec<RunStatistics>,
}

impl Group {
    /// Returns the position of the first run in its experiment.
    fn position(&self) -> Option<&ExperimentPosition> {
        self.runs.first()?.experiment.as_ref()
    }
}
