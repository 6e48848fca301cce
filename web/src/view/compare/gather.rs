//! Which runs are compared, and what they differ in.

use peernet_aggregator::{Bound, RunDetail, RunStatistics, RunSummary, StageStatistics, Store};
use peernet_logger::stream::ExperimentPlace;

use super::{Comparison, Configuration, done, letter, order, pool};
use crate::error::WebError;
use crate::view::place;

/// Most runs that an address may name.
pub(crate) const MOST_TYPED: usize = 12;
/// Most runs of an experiment that are compared.
pub(crate) const MOST_RUNS: u32 = 200;

/// What an address asks to compare.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    /// These runs, each for itself.
    Runs(Vec<i64>),
    /// All runs of an experiment that count, repeats together.
    Experiment(String),
}

impl Which {
    /// Reads `runs=1,2&runs=3` or `experiment=ID`. `None` when nothing is asked for.
    ///
    /// # Errors
    /// When a number is none, when there are too many, and when both are given.
    pub(crate) fn of(pairs: &[(String, String)]) -> Result<Option<Self>, WebError> {
        let bad = |text: String| Err(WebError::BadRequest(format!("query parameter {text}")));
        let (mut runs, mut experiment) = (Vec::<i64>::new(), None);
        for (name, value) in pairs {
            match name.as_str() {
                "runs" => {
                    for text in value.split(',').map(str::trim).filter(|text| !text.is_empty()) {
                        let Ok(number) = text.trim_start_matches('#').parse() else {
                            return bad(format!("runs: {text:?} is no number of a run"));
                        };
                        if !runs.contains(&number) {
                            runs.push(number);
                        }
                    }
                }
                "experiment" if !value.is_empty() => experiment = Some(value.clone()),
                "experiment" => {}
                other => return bad(format!("{other}: unknown, give runs or experiment")),
            }
        }
        match (runs.len(), experiment) {
            (0, None) => Ok(None),
            (0, Some(id)) => Ok(Some(Self::Experiment(id))),
            (_, Some(_)) => bad("experiment: give either runs or an experiment".to_owned()),
            (many, None) if many > MOST_TYPED => bad(format!("runs: {many} are more than {MOST_TYPED}")),
            (_, None) => Ok(Some(Self::Runs(runs))),
        }
    }
}

/// Reads what is to be compared: the figures of all runs at once, from their roll-ups.
///
/// # Errors
/// When a run or the experiment is not stored, or the store cannot be read.
pub(crate) async fn gather(store: &Store, which: &Which) -> Result<Comparison, WebError> {
    let (experiment, details, left_out, cut) = match which {
        Which::Runs(numbers) => {
            let mut details = Vec::with_capacity(numbers.len());
            for number in numbers {
                let run = store.run(*number).await?;
                details.push(run.ok_or_else(|| WebError::NotFound(format!("no run #{number} is stored")))?);
            }
            (None, details, Vec::new(), false)
        }
        Which::Experiment(id) => {
            let mut runs = store.runs_of_experiment(id, MOST_RUNS + 1).await?;
            let cut = runs.len() > MOST_RUNS as usize;
            runs.truncate(MOST_RUNS as usize);
            let first = runs.first().and_then(|run| run.experiment.clone());
            let Some(first) = first else {
                return Err(WebError::NotFound(format!("no run of an experiment {id} is stored")));
            };
            let (runs, left_out) = done::parted(runs);
            // Of an experiment the summary says all.
            let details = runs.into_iter().map(bare).collect();
            (Some((first.name, first.id)), details, left_out, cut)
        }
    };
    let numbers: Vec<i64> = details.iter().map(|detail| detail.summary.number).collect();
    let statistics = store.statistics(&numbers).await?;
    let (axes, values) = if experiment.is_some() { of_experiment(&details) } else { of_runs(&details) };
    let mut groups: Vec<Group> = Vec::new();
    for ((detail, RunStatistics { stages, bounds }), values) in
        details.into_iter().zip(statistics).zip(values)
    {
        let known = groups.iter_mut().find(|group| experiment.is_some() && group.values == values);
        match known {
            Some(group) => {
                group.runs.push(detail.summary);
                group.stages.push(stages);
                group.bounds.push(bounds);
            }
            None => groups.push(Group {
                values,
                runs: vec![detail.summary],
                stages: vec![stages],
                bounds: vec![bounds],
            }),
        }
    }
    if experiment.is_some() {
        groups.sort_by(|a, b| order::labels(&a.values, &b.values));
    }
    let configurations = groups.into_iter().enumerate().map(|(at, group)| Configuration {
        letter: letter(at),
        values: group.values,
        stages: pool::pooled(&group.stages),
        bounds: pool::bounds(&group.bounds),
        runs: group.runs,
    });
    Ok(Comparison { experiment, axes, configurations: configurations.collect(), left_out, cut })
}

struct Group {
    values: Vec<String>,
    runs: Vec<RunSummary>,
    stages: Vec<Vec<StageStatistics>>,
    bounds: Vec<Vec<Bound>>,
}

const fn bare(summary: RunSummary) -> RunDetail {
    RunDetail {
        summary,
        facts: Vec::new(),
        configuration: String::new(),
        version: String::new(),
        conditions: Vec::new(),
        gaps: Vec::new(),
    }
}

type Axes = (Vec<String>, Vec<Vec<String>>);

/// The axes of the experiment's file.
fn of_experiment(runs: &[RunDetail]) -> Axes {
    let configuration = |run: &RunDetail| {
        run.summary
            .experiment
            .as_ref()
            .map_or(&[][..], |place: &ExperimentPlace| &place.configuration)
            .to_vec()
    };
    let mut axes: Vec<String> = Vec::new();
    for (axis, _) in runs.iter().flat_map(configuration) {
        if !axes.contains(&axis) {
            axes.push(axis);
        }
    }
    tabulate(axes, runs, configuration)
}

/// What is known of the runs and not the same for all of them.
fn of_runs(runs: &[RunDetail]) -> Axes {
    let known = |run: &RunDetail| {
        let summary = &run.summary;
        let mut pairs = vec![
            ("Pipeline".to_owned(), summary.pipeline.to_string()),
            ("Where".to_owned(), place::route(summary.host_name.as_str(), &summary.placement)),
            ("Model".to_owned(), place::model(&summary.placement)),
        ];
        pairs.extend(summary.placement.network.iter().map(|network| ("Network".to_owned(), network.clone())));
        pairs.extend(summary.experiment.iter().flat_map(|place| place.configuration.clone()));
        pairs.extend(run.facts.iter().cloned());
        pairs
    };
    let mut axes: Vec<String> = Vec::new();
    for (name, _) in runs.iter().flat_map(known) {
        if !axes.contains(&name) {
            axes.push(name);
        }
    }
    let (axes, values) = tabulate(axes, runs, known);
    let differs = |at: usize| values.iter().any(|row| row[at] != values[0][at]);
    // Several names for one difference are one difference.
    let same = |a: usize, b: usize| values.iter().all(|row| row[a] == row[b]);
    let kept: Vec<usize> =
        (0..axes.len()).filter(|at| differs(*at) && !(0..*at).any(|before| same(before, *at))).collect();
    let pick = |row: &Vec<String>| kept.iter().map(|at| row[*at].clone()).collect();
    (kept.iter().map(|at| axes[*at].clone()).collect(), values.iter().map(pick).collect())
}

fn tabulate(
    axes: Vec<String>,
    runs: &[RunDetail],
    pairs: impl Fn(&RunDetail) -> Vec<(String, String)>,
) -> Axes {
    let row = |run: &RunDetail| {
        let pairs = pairs(run);
        let of = |axis: &String| {
            let found = pairs.iter().find(|(name, _)| name == axis);
            found.map_or_else(|| crate::numbers::NONE.to_owned(), |(_, value)| value.clone())
        };
        axes.iter().map(of).collect::<Vec<String>>()
    };
    let values = runs.iter().map(row).collect();
    (axes, values)
}
