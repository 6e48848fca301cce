//! Runs side by side: the paper's table, and how far differences between them are known.
//!
//! ```text
//! Loaded, Loaded, … ── configuration ── Comparison ─┬─ text, Markdown, CSV, LaTeX
//!                          blocks ── bootstrap ─────┴─ Differences (two lines of it)
//! ```

mod blocks;
mod bootstrap;
mod configuration;
mod differences;
mod render;

pub use bootstrap::{Difference, Statistic, difference};
pub use differences::{Differences, StageDifference};

use peernet_statistics::Moments;

use crate::results::{Loaded, Row};
pub(crate) use configuration::Configurations;

/// The columns of the paper's table that hold latencies; the last two are the sum of all stages, which the paper calls
/// Total, and the measured total.
pub const LATENCIES: [&str; 6] = ["sensing", "upload", "inference", "download", "stages-total", "total"];

/// The seed where none is given: the same runs give the same figures.
pub const SEED: u64 = 1;

/// What becomes of repeats of one configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Repeats {
    /// Their iterations are taken together, in one line: the paper's table.
    #[default]
    Pooled,
    /// Each has a line of its own.
    Apart,
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
    /// Lines of which it is not known, with 95 % confidence, that they differ from the best.
    pub ties: Vec<usize>,
    /// What the best is the best of: `total`, or `stages-total` where not all runs have the former.
    pub by: &'static str,
}

/// One configuration.
#[derive(Clone, Debug)]
pub struct Line {
    /// What distinguishes it: as many labels as there are axes.
    pub labels: Vec<String>,
    /// The runs that are taken together, as numbers of what was given.
    pub runs: Vec<usize>,
    /// How many iterations count.
    pub count: u64,
    /// How many did not end with an answer, warm-up left out.
    pub unanswered: u64,
    /// The latencies in the order of [`LATENCIES`]; `None` where no iteration that counts has one.
    pub latencies: [Option<Latency>; LATENCIES.len()],
    /// Every run's values of what the best is found by, in order.
    deciding: Vec<Vec<f64>>,
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
        Self::with(runs, Repeats::Pooled, SEED)
    }

    /// Compares runs. The seed is for what decides ties.
    pub fn with(runs: &[Loaded], repeats: Repeats, seed: u64) -> Self {
        let mut configurations = Configurations::of(runs);
        if repeats == Repeats::Apart {
            configurations.add_repeats(runs);
        }
        let Configurations { axes, labels } = configurations;
        let measured = runs.iter().flat_map(|run| &run.rows).filter(|row| row.counts());
        let by =
            if measured.clone().all(|row| row.value("total").is_some()) { "total" } else { "stages-total" };
        let mut lines: Vec<Line> = Vec::new();
        for (number, labels) in labels.into_iter().enumerate() {
            match lines.iter_mut().find(|line| line.labels == labels) {
                Some(line) => line.runs.push(number),
                None => lines.push(Line::new(labels, number)),
            }
        }
        lines.iter_mut().for_each(|line| line.fill(runs, by));
        let mut this = Self { axes, lines, best: None, ties: Vec::new(), by };
        this.mark(seed);
        this
    }

    fn mark(&mut self, seed: u64) {
        let means =
            self.lines.iter().enumerate().filter_map(|(at, line)| Some((at, line.latency(self.by)?.mean)));
        let best = means.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(at, _)| at);
        let Some(best) = best.filter(|_| self.lines.len() > 1) else { return };
        let tied = |at: &usize| {
            let (best, other) = (&self.lines[best].deciding, &self.lines[*at].deciding);
            let difference = difference(best, other, Statistic::Mean, seed);
            // Too few values to tell are no difference either.
            difference.is_some_and(|difference| difference.is_distinct() != Some(true))
        };
        self.ties = (0..self.lines.len()).filter(|at| *at != best).filter(tied).collect();
        self.best = Some(best);
    }
}

impl Line {
    fn new(labels: Vec<String>, run: usize) -> Self {
        let latencies = [None; LATENCIES.len()];
        Self { labels, runs: vec![run], count: 0, unanswered: 0, latencies, deciding: Vec::new() }
    }

    fn fill(&mut self, runs: &[Loaded], by: &str) {
        let mut moments = [Moments::default(); LATENCIES.len()];
        for rows in self.runs.iter().map(|run| &runs[*run].rows) {
            for row in rows.iter().filter(|row| row.counts()) {
                self.count += 1;
                for (moments, name) in moments.iter_mut().zip(LATENCIES) {
                    row.value(name)
                        .filter(|value| value.is_finite())
                        .into_iter()
                        .for_each(|v| moments.record(v));
                }
            }
            self.unanswered += rows.iter().filter(|row| !row.warm_up && !row.counts()).count() as u64;
            self.deciding.push(values(rows, by));
        }
        let latency =
            |moments: Moments| Latency { mean: moments.mean, std: moments.std(), count: moments.count };
        self.latencies = moments.map(|moments| (moments.count > 0).then(|| latency(moments)));
    }

    /// A latency by its name in [`LATENCIES`].
    pub fn latency(&self, name: &str) -> Option<Latency> {
        LATENCIES.iter().position(|other| *other == name).and_then(|at| self.latencies[at])
    }
}

/// A column's numbers in the rows that count, in order.
fn values(rows: &[Row], column: &str) -> Vec<f64> {
    let counted = rows.iter().filter(|row| row.counts());
    counted.filter_map(|row| row.value(column)).filter(|value| value.is_finite()).collect()
}

#[cfg(test)]
mod tests;
