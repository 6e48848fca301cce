//! Runs side by side: the paper's table, and how far differences between them are known.
//!
//! ```text
//! Loaded, Loaded, … ── configuration ── Comparison ─┬─ text, Markdown, CSV, LaTeX
//!           difference (means) ─────────────────────┼─ Differences (two lines of it)
//!           blocks ── median_bootstrap ─────────────┤
//!                                                   └─ the best against the others (three lines and more)
//! ```

mod best;
mod blocks;
mod columns;
mod configuration;
mod difference;
mod differences;
mod doubts;
mod median_bootstrap;
mod pairwise;
mod ranking;
mod render;
#[cfg(test)]
mod testing;

pub use best::against_best;
pub use columns::{ChosenColumns, Column, choose_columns};
pub use configuration::Configurations;
pub use difference::{Difference, MIN_BATCHES, MIN_VALUES, MeanEstimate};
pub use differences::{Differences, StageDifference};
pub use doubts::skipped_starts;
pub use pairwise::PairwiseDifference;
pub use ranking::{Ranking, computes};

use peernet_statistics::{Moments, Summary};

use crate::accuracy::{ACCURACIES, Accuracy, UNKNOWN_LABEL, UnknownLabels};
use crate::deadline::{DEADLINE_MISSED, Misses};
use crate::loaded::{Loaded, unknown_labels};
use crate::rows::{Rows, SKIPPED_STARTS};
use crate::trust::Starts;
use configuration::NOTHING;

/// The columns of the paper's table that hold latencies; the last two are the sum of all stages, which the paper calls
/// Total, and the measured total.
pub const LATENCIES: [&str; 6] = ["sensing", "upload", "inference", "download", "stages-total", "total"];

/// The seed of the bootstrap where none is given: the same runs give the same figures.
pub const SEED: u64 = 1;

/// Less than this share of iterations with a known delay is told.
const NEARLY_ALL: f64 = 0.95;

/// What becomes of repeats of one configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Repeats<'a> {
    /// Their iterations are taken together, in one line: the paper's table.
    #[default]
    Pooled,
    /// Each has a line of its own.
    Apart,
    /// Pooled, but for these runs, numbers of what is given: they have a line of their own, beside the other repeats of their
    /// configuration.
    Beside(&'a [usize]),
}

/// Runs side by side.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Names of the columns that tell the lines apart.
    pub axes: Vec<String>,
    /// One for each configuration, in the order in which they came.
    pub lines: Vec<Line>,
    /// The line with the smallest mean of [`by`](Self::by); `None` for a single line, or when none was measured.
    pub best: Option<usize>,
    /// Lines that, with 95 % confidence, cannot be told from the best.
    pub ties: Vec<usize>,
    /// Lines of which nobody can say whether they differ from the best: they, or the best, have too few iterations, or
    /// none.
    pub untested: Vec<usize>,
    /// Lines that are not ranked, because their model computes nothing.
    pub unranked: Vec<usize>,
    /// What the best is the best of: `total`, or `stages-total` where not all runs have the former.
    pub by: &'static str,
    /// What else differs among the runs, in sentences.
    pub rest: Vec<String>,
    /// What is wrong with the results, in sentences: files that are not whole, numbers that are none.
    pub doubts: Vec<String>,
}

/// One configuration.
#[derive(Clone, Debug)]
pub struct Line {
    /// What distinguishes it: as many labels as there are axes.
    pub labels: Vec<String>,
    /// The results that are taken together, as numbers of what was given.
    pub runs: Vec<usize>,
    /// How many runs they are of: those of edges that were measured at once are of one.
    pub repeats: usize,
    /// The most edges that were measured at once.
    pub edges: usize,
    /// How many iterations count.
    pub count: u64,
    /// How many did not end with an answer, warm-up left out.
    pub unanswered: u64,
    /// How many of both missed their deadline; `None` without one.
    pub misses: Option<Misses>,
    /// What became of the starts that an open loop ordered; the rate is not asked for.
    pub starts: Starts,
    /// The latencies in the order of [`LATENCIES`]; `None` where no iteration that counts has one.
    pub latencies: [Option<Latency>; LATENCIES.len()],
    /// How often it was right, in the order of [`ACCURACIES`]; `None` where nobody knew the right answers.
    pub accuracies: [Option<Accuracy>; ACCURACIES.len()],
    /// Samples that are neither right nor wrong, because their label is no class of the model.
    pub unknown_labels: Option<UnknownLabels>,
    /// How much larger its mean of [`by`](Comparison::by) is than the best's; `None` of the best itself, or where there is
    /// no mean.
    pub beyond_best: Option<Difference>,
    /// What the best is found by, of each repeat.
    deciding: Vec<Moments>,
}

/// A latency of a configuration, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latency {
    /// Mean over all iterations.
    pub mean: f64,
    /// Their sample standard deviation; `None` below two.
    pub std: Option<f64>,
    /// How many iterations have it: less than count when a clock was not related to the other at times.
    pub count: u64,
}

impl Comparison {
    /// Compares runs; repeats are taken together.
    pub fn of(runs: &[Loaded]) -> Self {
        Self::with(runs, Repeats::Pooled)
    }

    /// Compares runs.
    pub fn with(runs: &[Loaded], repeats: Repeats<'_>) -> Self {
        let (mut configurations, rest) = Configurations::and_the_rest(runs);
        match repeats {
            Repeats::Pooled => {}
            Repeats::Apart => configurations.add_repeats(runs),
            Repeats::Beside(chosen) => configurations.set_apart(runs, chosen),
        }
        let Configurations { axes, labels } = configurations;
        let mut measured = runs.iter().flat_map(|run| &run.rows).filter(|row| row.counts());
        let by = if measured.all(|row| row.value("total").is_some()) { "total" } else { "stages-total" };
        let mut lines: Vec<Line> = Vec::new();
        for (number, labels) in labels.into_iter().enumerate() {
            match lines.iter_mut().find(|line| line.labels == labels) {
                Some(line) => line.runs.push(number),
                None => lines.push(Line::new(labels, number)),
            }
        }
        lines.iter_mut().for_each(|line| line.fill(runs, by));
        let (ties, untested, unranked) = (Vec::new(), Vec::new(), Vec::new());
        let doubts = doubts::sentences(runs, &lines);
        let mut this = Self { axes, lines, best: None, ties, untested, unranked, by, rest, doubts };
        best::mark(&mut this, runs);
        this
    }
}

impl Line {
    fn new(labels: Vec<String>, run: usize) -> Self {
        Self {
            labels,
            runs: vec![run],
            repeats: 1,
            edges: 1,
            count: 0,
            unanswered: 0,
            misses: None,
            starts: Starts::default(),
            latencies: [None; LATENCIES.len()],
            accuracies: [None; ACCURACIES.len()],
            unknown_labels: None,
            beyond_best: None,
            deciding: Vec::new(),
        }
    }

    fn fill(&mut self, runs: &[Loaded], by: &str) {
        // Which repeat each is of, and how many edges each has.
        let mut repeats: Vec<(Option<u32>, usize)> = Vec::new();
        for Loaded { record, rows, .. } in self.runs.iter().map(|run| &runs[*run]) {
            self.count += rows.iter().filter(|row| row.counts()).count() as u64;
            self.unanswered += rows.iter().filter(|row| !row.warm_up() && !row.counts()).count() as u64;
            let starts = Starts::of_rows(rows);
            self.starts.kept += starts.kept;
            self.starts.skipped += starts.skipped;
            let repeat = record.experiment.as_ref().map(|place| place.repeat);
            let known = repeats.iter().position(|(other, _)| *other == repeat);
            let at = known.unwrap_or_else(|| {
                repeats.push((repeat, 0));
                self.deciding.push(Moments::default());
                repeats.len() - 1
            });
            repeats[at].1 += 1;
            values(rows, by).iter().for_each(|value| self.deciding[at].record(*value));
        }
        self.repeats = repeats.len();
        self.edges = repeats.iter().map(|(_, edges)| *edges).max().unwrap_or(1);
        let of_line = || self.runs.iter().map(|run| &runs[*run]);
        let rows = || of_line().flat_map(|run| &run.rows);
        self.misses = Misses::of_rows(rows());
        self.accuracies = ACCURACIES.map(|column| Accuracy::of(rows(), column));
        self.unknown_labels = unknown_labels(of_line());
        self.latencies = LATENCIES.map(|name| {
            let mut moments = Moments::default();
            let numbers = of_line().flat_map(|run| run.rows.counted(name));
            numbers.filter(|number| Summary::accepts(*number)).for_each(|number| moments.record(number));
            let Moments { mean, count, .. } = moments;
            (count > 0).then(|| Latency { mean, std: moments.std(), count })
        });
    }

    /// An accuracy by its name in [`ACCURACIES`].
    pub fn accuracy(&self, name: &str) -> Option<Accuracy> {
        ACCURACIES.iter().position(|other| *other == name).and_then(|at| self.accuracies[at])
    }

    /// A latency by its name in [`LATENCIES`].
    pub fn latency(&self, name: &str) -> Option<Latency> {
        LATENCIES.iter().position(|other| *other == name).and_then(|at| self.latencies[at])
    }
}

/// A column's finite numbers in the rows that count, in order.
fn values(rows: &Rows, column: &str) -> Vec<f64> {
    rows.counted(column).filter(|value| Summary::accepts(*value)).collect()
}

/// Whether a comparison asks for a column: what `peernet_results::ResultFolder::open_columns` is to read.
pub fn is_compared(column: &str) -> bool {
    let bounds = ["upload-lo", "upload-hi", "download-lo", "download-hi"];
    let all = differences::STAGES.iter().chain(&LATENCIES).chain(&ACCURACIES).chain(&bounds);
    all.chain(&[UNKNOWN_LABEL, SKIPPED_STARTS, DEADLINE_MISSED]).any(|name| *name == column)
}

#[cfg(test)]
mod tests;
