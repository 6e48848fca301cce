//! Comparison of runs: the paper's table, and differences with their confidence intervals.
//!
//! ```text
//! Loaded, Loaded, … ── configuration ── Comparison ─┬─ text, Markdown, CSV, LaTeX
//!           difference (means) ─────────────────────┼─ Differences (of two lines)
//!           blocks ── median_bootstrap ─────────────┤
//!                                                   └─ the best against the others (three lines and more)
//! ```

mod best;
mod blocks;
mod caveats;
mod columns;
mod configuration;
mod csv;
mod difference;
mod difference_table;
mod differences;
mod labels;
mod latency_bar;
mod median_bootstrap;
mod order;
mod pairwise;
mod ranking;
mod render;
#[cfg(test)]
mod testing;

pub use best::differences_to_best;
pub use caveats::{replayed_configurations, skipped_starts};
pub use columns::{ChosenColumns, Column, choose_columns, choose_further_columns};
pub use configuration::{Configurations, group_by_labels};
pub use difference::{Difference, MIN_BATCHES, MIN_VALUES, MeanEstimate};
pub use differences::{Differences, STAGES, StageDifference};
pub(crate) use labels::csv_labels;
pub use labels::{
    RunFacts, describe_labels, distinguishing_pairs, experiment_columns, readable_names, tabulate,
};
pub use latency_bar::LatencyBar;
pub use order::{compare_label, compare_positions};
pub use pairwise::PairwiseDifference;
pub use ranking::{ConfigurationTotal, Ranking, default_baseline, find_unranked, model_computes};

use peernet_logger::stage;
use peernet_statistics::{Moments, Summary};

use crate::accuracy::{ACCURACIES, Accuracy, UnknownLabels};
use crate::actuator_results::{ActuatorResults, EPISODE_VALUES, SUPERSEDED};
use crate::concurrent_edges::concurrent_groups;
use crate::deadline::{DEADLINE_MISSED, Misses};
use crate::loaded::{Loaded, unknown_labels};
use crate::outcomes::Counts;
use crate::quality::{Quality, QualityEstimate};
use crate::rows::{Rows, SKIPPED_STARTS};
use crate::total_column::TotalColumn;
use crate::trust::{DRAWN_LATENCY_COLUMN, OVERRUN_COLUMN, ReplayedLatencies, Starts};
use labels::EMPTY_CELL;

/// Latency columns of the paper's table; the last two are the sum of all stages, which the paper calls Total, and the
/// measured total.
pub const LATENCIES: [&str; 6] = ["sensing", "upload", "inference", "download", "stages-total", "total"];

/// Scores that are shown as means over the answers. [`ACCURACIES`] are shown as shares of right answers instead.
pub const SCORES: [Quality; 2] = [Quality::Map50, Quality::MeanIou];

/// Column of the time from the request to a language model until its first token.
const FIRST_TOKEN: &str = "inference_time-to-first-token";

/// Default seed of the bootstrap, so that the same runs give the same numbers.
pub const SEED: u64 = 1;

/// A note reports the share of the iterations for which a delay is known, if the share is below this value.
const MIN_KNOWN_SHARE: f64 = 0.95;

/// A note lists the stages that have no column in the table, if they take at least this share of the sum of all stages.
const MIN_HIDDEN_SHARE: f64 = 0.01;

/// Treatment of repeats of one configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Repeats<'a> {
    /// Repeats are pooled into one line, as in the paper's table.
    #[default]
    Pooled,
    /// Each repeat is a line.
    Separate,
    /// Repeats are pooled, except for the repeats of the runs with these indices. These repeats have a separate line,
    /// next to the line of the other repeats of the same configuration.
    PooledExcept(&'a [usize]),
}

/// Comparison of runs.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Names of the columns that distinguish the lines, such as `model` and `network`.
    pub axes: Vec<String>,
    /// One line for each configuration, in the order of the input.
    pub lines: Vec<Line>,
    /// Index of the line with the smallest mean of [`total_column`](Self::total_column). `None` if
    /// fewer than two lines can be ranked, or if none of them has a mean.
    pub best: Option<usize>,
    /// Indices of the lines whose difference from the best may be chance: its 95 % confidence interval contains zero.
    pub ties: Vec<usize>,
    /// Indices of the lines that cannot be compared with the best, because they or the best have too few iterations.
    pub untested: Vec<usize>,
    /// Indices of the lines that are not ranked, because their model computes nothing: see [`find_unranked`].
    pub unranked: Vec<usize>,
    /// Column that determines the best line.
    pub total_column: TotalColumn,
    /// Other differences among the runs, in sentences.
    pub other_differences: Vec<String>,
    /// Defects of the results, in sentences: incomplete files, invalid numbers.
    pub caveats: Vec<String>,
}

/// Statistics of one configuration.
#[derive(Clone, Debug)]
pub struct Line {
    /// Labels that distinguish the line: as many as there are axes.
    pub labels: Vec<String>,
    /// Name in sentences ([`readable_names`]), as on the page *Compare* and in figures.
    pub name: String,
    /// Indices of the runs in this line.
    pub runs: Vec<usize>,
    /// Number of repeats. Results of edges that were measured at the same time belong to one repeat.
    pub repeats: usize,
    /// Maximum number of edges that were measured at the same time.
    pub edges: usize,
    /// Number of iterations in the statistics: neither warm-up nor failed.
    pub count: u64,
    /// Number of failed iterations, without the warm-up: iterations that have no answer, or an answer that the actuator
    /// failed to act on.
    pub failed: u64,
    /// Number of iterations after the warm-up that missed their deadline, including failed ones; `None` without a
    /// deadline.
    pub misses: Option<Misses>,
    /// Superseded answers, and success and return of the episodes.
    pub actuator: ActuatorResults,
    /// Numbers of actual and of skipped starts of an open loop. The rates in this value are `None`, because each run
    /// has its own rate.
    pub starts: Starts,
    /// Distribution that the latencies of the model are drawn from; `None` if all latencies are measured.
    pub replayed: Option<String>,
    /// Latencies in the order of [`LATENCIES`]; `None` if no iteration in the statistics has the latency.
    pub latencies: [Option<Latency>; LATENCIES.len()],
    /// Stages without a latency in [`LATENCIES`] that take a notable part of the sum of all stages: name, and mean in
    /// seconds over all iterations in the statistics. An iteration without the stage counts as 0.
    pub hidden_stages: Vec<(&'static str, f64)>,
    /// Time from the request to a language model until its first token; `None` for other models.
    pub first_token: Option<Latency>,
    /// Accuracies in the order of [`ACCURACIES`]; `None` where the right answers are not known.
    pub accuracies: [Option<Accuracy>; ACCURACIES.len()],
    /// Mean scores of the answers in the order of [`SCORES`]; `None` where no answer has the score.
    pub scores: [Option<QualityEstimate>; SCORES.len()],
    /// Samples whose label is not a class of the model. Their answers are neither right nor wrong.
    pub unknown_labels: Option<UnknownLabels>,
    /// Mean of [`total_column`](Comparison::total_column) minus that of the best line. `None` for
    /// the best line itself, for a line that is not ranked, and without a mean.
    pub difference_to_best: Option<Difference>,
    /// Moments of [`total_column`](Comparison::total_column), for each repeat.
    repeat_moments: Vec<Moments>,
}

/// Latency of a configuration, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latency {
    /// Mean over the iterations with this latency.
    pub mean: f64,
    /// Sample standard deviation; `None` below two values.
    pub std: Option<f64>,
    /// Number of iterations with this latency. It is less than the count of the line if some delays are not known.
    pub count: u64,
}

impl Comparison {
    /// Compares runs; repeats are pooled.
    pub fn new(runs: &[Loaded]) -> Self {
        Self::with_repeats(runs, Repeats::Pooled)
    }

    /// Compares runs.
    pub fn with_repeats(runs: &[Loaded], repeats: Repeats<'_>) -> Self {
        let (mut configurations, other_differences) = Configurations::with_other_differences(runs);
        match repeats {
            Repeats::Pooled => {}
            Repeats::Separate => configurations.add_repeats(runs),
            Repeats::PooledExcept(chosen) => configurations.separate_repeats(runs, chosen),
        }
        let groups = configurations.named_groups();
        let Configurations { axes, labels } = configurations;
        // All lines have the same column: a measured total is longer than the sum of its stages, so a total cannot be
        // ranked against a sum.
        let total_column = TotalColumn::from_rows(runs.iter().flat_map(|run| &run.rows));
        let line = |(name, group): (String, Vec<usize>)| Line::new(name, labels[group[0]].clone(), group);
        let mut lines: Vec<Line> = groups.into_iter().map(line).collect();
        lines.iter_mut().for_each(|line| line.fill(runs, total_column.name()));
        let (ties, untested, unranked) = (Vec::new(), Vec::new(), Vec::new());
        let caveats = caveats::sentences(runs, &lines);
        let mut comparison = Self {
            axes,
            lines,
            best: None,
            ties,
            untested,
            unranked,
            total_column,
            other_differences,
            caveats,
        };
        best::rank_lines(&mut comparison, runs);
        comparison
    }
}

impl Line {
    fn new(name: String, labels: Vec<String>, runs: Vec<usize>) -> Self {
        Self {
            name,
            labels,
            runs,
            repeats: 1,
            edges: 1,
            count: 0,
            failed: 0,
            misses: None,
            actuator: ActuatorResults::default(),
            starts: Starts::default(),
            replayed: None,
            latencies: [None; LATENCIES.len()],
            hidden_stages: Vec::new(),
            first_token: None,
            accuracies: [None; ACCURACIES.len()],
            scores: [None; SCORES.len()],
            unknown_labels: None,
            difference_to_best: None,
            repeat_moments: Vec::new(),
        }
    }

    /// Computes the statistics of the line from its runs.
    fn fill(&mut self, runs: &[Loaded], total_column: &str) {
        let runs_of_line = || self.runs.iter().map(|run| &runs[*run]);
        // Runs of several edges at the same time are one repeat.
        let repeats = concurrent_groups(
            runs_of_line(),
            |run| run.record.experiment.as_ref(),
            |run| &run.record.edge.name,
        );
        self.repeats = repeats.len();
        self.edges = repeats.iter().map(Vec::len).max().unwrap_or(1);
        let moments = |edges: &Vec<&Loaded>| {
            let mut moments = Moments::default();
            let values = edges.iter().flat_map(|edge| accepted_values(&edge.rows, total_column));
            values.for_each(|value| moments.record(value));
            moments
        };
        self.repeat_moments = repeats.iter().map(moments).collect();
        for Loaded { rows, .. } in runs_of_line() {
            // The number of unseen iterations is not used here, so it is set to 0.
            let counts = Counts::from_rows(rows, 0);
            self.count += counts.ok;
            self.failed += counts.all_failed();
        }
        self.starts = Starts::sum(runs_of_line().map(|run| Starts::from_rows(&run.rows)));
        let rows = || runs_of_line().flat_map(|run| &run.rows);
        let replayed =
            runs_of_line().filter_map(|run| ReplayedLatencies::from_run(&run.record.facts, &run.rows));
        self.replayed = ReplayedLatencies::describe_all(replayed);
        self.misses = Misses::from_rows(rows());
        self.actuator = ActuatorResults::from_rows(rows());
        self.accuracies = ACCURACIES.map(|column| Accuracy::from_rows(rows(), column));
        self.scores = SCORES.map(|score| score.from_rows(rows));
        self.unknown_labels = unknown_labels(runs_of_line());
        let latency = |name: &str| {
            let moments: Moments =
                runs_of_line().flat_map(|run| run.rows.values_in_statistics(name)).collect();
            let Moments { mean, count, .. } = moments;
            (count > 0).then(|| Latency { mean, std: moments.std(), count })
        };
        self.latencies = LATENCIES.map(latency);
        self.first_token = latency(FIRST_TOKEN);
        let sum = |latency: Latency| latency.mean * latency.count as f64;
        let sum_of_stages = self.latency("stages-total").map_or(0.0, sum);
        let without_column = differences::stage_names().filter(|name| !LATENCIES.contains(name));
        let hidden = without_column
            .filter_map(|name| Some((name, sum(latency(name)?))))
            .filter(|(_, sum)| *sum > 0.0 && *sum >= MIN_HIDDEN_SHARE * sum_of_stages);
        self.hidden_stages = hidden.map(|(name, sum)| (name, sum / self.count as f64)).collect();
    }

    /// Returns an accuracy by its name in [`ACCURACIES`].
    pub fn accuracy(&self, name: &str) -> Option<Accuracy> {
        ACCURACIES.iter().position(|other| *other == name).and_then(|index| self.accuracies[index])
    }

    /// Returns a latency by its name in [`LATENCIES`].
    pub fn latency(&self, name: &str) -> Option<Latency> {
        LATENCIES.iter().position(|other| *other == name).and_then(|index| self.latencies[index])
    }

    /// Returns the share of the iterations in the statistics for which a one-way delay is known, if it is so small that
    /// a note reports it. `None` for other latencies.
    fn small_known_share(&self, name: &str) -> Option<f64> {
        let share = self.latency(name)?.count as f64 / self.count as f64;
        (stage::is_one_way(name) && share < MIN_KNOWN_SHARE).then_some(share)
    }
}

/// Returns the numbers of a column, in order, from the rows in the statistics. Numbers that [`Summary::accepts`]
/// rejects are left out.
fn accepted_values(rows: &Rows, column: &str) -> Vec<f64> {
    rows.values_in_statistics(column).filter(|value| Summary::accepts(*value)).collect()
}

/// Returns whether a comparison needs a column. `peernet_results::ResultFolder::open_columns` reads only such columns.
pub fn needs_column(column: &str) -> bool {
    let bounds = ["upload-lo", "upload-hi", "download-lo", "download-hi"];
    let columns = STAGES.iter().chain(&LATENCIES).chain(&ACCURACIES).chain(&bounds);
    let columns = columns.chain(&[SKIPPED_STARTS, DEADLINE_MISSED, SUPERSEDED, FIRST_TOKEN]);
    // `at` is the start of an iteration. The last start stands for the end of a run whose end is not recorded. The
    // starts of the first and the last iteration, and the last episode, show how much of an interrupted run is missing.
    let columns = columns.chain(&[DRAWN_LATENCY_COLUMN, OVERRUN_COLUMN, "at", "iteration", "episode"]);
    columns.chain(&EPISODE_VALUES).chain(&SCORES.map(Quality::name)).any(|name| *name == column)
        || stage::UNKNOWN_LABEL == *column
}

#[cfg(test)]
mod tests;
