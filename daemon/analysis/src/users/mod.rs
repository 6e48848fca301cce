//! Statistics of many users of one cloud at the same time: latency against the number of users, and fairness.
//!
//! ```text
//! Loaded ── concurrent_edges ──┐
//!                              Users ─┬─ text, Markdown, LaTeX, CSV
//! roll-ups ── UsersLine ───────┘      └─ curves   latency against the number of edges
//! ```

mod concurrent_edges;
mod curves;
mod tables;

pub use curves::Curve;

use crate::loaded::Loaded;
use crate::order::SortedValues;

/// Returns Jain's index of fairness, (Σx)² / (n Σx²). It is 1/n if one of n users gets everything, and 1 if all get the same. `None` if all
/// shares are 0 (Jain, Chiu and Hawe 1984, *A Quantitative Measure of Fairness and Discrimination for Resource Allocation in Shared
/// Computer Systems*, DEC-TR-301).
pub fn jain_index(shares: &[f64]) -> Option<f64> {
    let (sum, squares) = shares.iter().fold((0.0, 0.0), |(sum, squares), x| (sum + x, squares + x * x));
    // Because of rounding, the index of equal shares can be a little more than 1.
    (squares > 0.0).then(|| (sum * sum / (shares.len() as f64 * squares)).min(1.0))
}

/// Results of configurations with one or many users.
#[derive(Clone, Debug, PartialEq)]
pub struct Users {
    /// Names of the columns that distinguish the lines.
    pub axes: Vec<String>,
    /// One line for each configuration, in the order of the input.
    pub lines: Vec<UsersLine>,
}

/// Results of one configuration. Seconds, answers per second.
#[derive(Clone, Debug, PartialEq)]
pub struct UsersLine {
    /// Labels that distinguish the configuration: as many as there are axes.
    pub labels: Vec<String>,
    /// Number of edges at the same time.
    pub edges: usize,
    /// Answers per second of all edges together, on average over the repeats; `None` if the edges never measured at the same time.
    pub rate: Option<f64>,
    /// [`jain_index`] of the edges' rates, on average over the repeats.
    pub fairness: Option<f64>,
    /// Share of each edge in each repeat.
    pub shares: Vec<EdgeShare>,
    /// The totals of all edges.
    pub totals: Totals,
}

/// Share of one edge while all edges were measuring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeShare {
    /// Answers per second.
    pub rate: f64,
    /// Median of the edge's totals, seconds; `None` if no total was measured.
    pub median: Option<f64>,
}

/// Summary of totals, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Totals {
    /// Number of totals.
    pub count: usize,
    /// Mean of the totals.
    pub mean: Option<f64>,
    /// Median of the totals.
    pub median: Option<f64>,
    /// 95th percentile; `None` below 60 totals.
    pub p95: Option<f64>,
    /// 99th percentile; `None` below 300 totals.
    pub p99: Option<f64>,
}

impl Users {
    /// Returns the statistics of runs, one run for each edge. Edges that measured at the same time are found by their records. `None` if no
    /// two edges measured at the same time.
    pub fn from_runs(runs: &[Loaded]) -> Option<Self> {
        let concurrent_groups = concurrent_edges::concurrent_groups(runs);
        concurrent_groups.iter().any(|edges| edges.len() > 1).then_some(())?;
        let configuration = |edges: &[&Loaded]| -> Vec<(String, String)> {
            let experiment = edges.first().and_then(|edge| edge.record.experiment.as_ref());
            experiment.map(|place| place.configuration.clone()).unwrap_or_default()
        };
        let mut axes: Vec<String> = Vec::new();
        for (axis, _) in concurrent_groups.iter().flat_map(|edges| configuration(edges)) {
            if !axes.contains(&axis) {
                axes.push(axis);
            }
        }
        let label = |edges: &[&Loaded], axis: &String| {
            let axis_and_label = configuration(edges).into_iter().find(|(name, _)| name == axis);
            axis_and_label.map_or_else(|| tables::EMPTY_CELL.to_owned(), |(_, label)| label)
        };
        // Repeats of each configuration: the groups of edges with the same labels and the same number of edges.
        let mut configurations: Vec<(Vec<String>, Vec<&[&Loaded]>)> = Vec::new();
        for edges in &concurrent_groups {
            let labels: Vec<String> = axes.iter().map(|axis| label(edges, axis)).collect();
            let is_same = |(other, repeats): &&mut (Vec<String>, Vec<&[&Loaded]>)| {
                *other == labels && repeats[0].len() == edges.len()
            };
            match configurations.iter_mut().find(is_same) {
                Some((_, repeats)) => repeats.push(edges),
                None => configurations.push((labels, vec![edges])),
            }
        }
        let line = |(labels, repeats): (Vec<String>, Vec<&[&Loaded]>)| {
            let shares_and_totals: Vec<(Vec<EdgeShare>, Vec<f64>)> =
                repeats.iter().filter_map(|edges| concurrent_edges::shares_and_totals(edges)).collect();
            let totals: SortedValues =
                shares_and_totals.iter().flat_map(|(_, totals)| totals).copied().collect();
            let shares: Vec<Vec<EdgeShare>> =
                shares_and_totals.into_iter().map(|(shares, _)| shares).collect();
            UsersLine::new(labels, repeats[0].len(), &shares, Totals::from_values(&totals))
        };
        Some(Self { axes, lines: configurations.into_iter().map(line).collect() })
    }
}

impl UsersLine {
    /// Returns the line of a configuration with `edges` edges, from the share of each edge in each repeat.
    pub fn new(labels: Vec<String>, edges: usize, repeats: &[Vec<EdgeShare>], totals: Totals) -> Self {
        let rates = |shares: &Vec<EdgeShare>| shares.iter().map(|share| share.rate).collect::<Vec<f64>>();
        let rates: Vec<Vec<f64>> = repeats.iter().map(rates).collect();
        Self {
            labels,
            edges,
            rate: mean(rates.iter().map(|rates| rates.iter().sum())),
            fairness: mean(rates.iter().filter_map(|rates| jain_index(rates))),
            shares: repeats.concat(),
            totals,
        }
    }

    /// Returns the line of a configuration from whole runs, each given by the number of its repeat and the share of its edge. Repeats that
    /// lack an edge are left out.
    pub fn from_whole_runs(labels: Vec<String>, runs: &[(u32, Option<EdgeShare>)], totals: Totals) -> Self {
        let mut repeats: Vec<(u32, Vec<Option<EdgeShare>>)> = Vec::new();
        for (repeat, share) in runs {
            match repeats.iter_mut().find(|(number, _)| number == repeat) {
                Some((_, shares)) => shares.push(*share),
                None => repeats.push((*repeat, vec![*share])),
            }
        }
        let edges = repeats.iter().map(|(_, shares)| shares.len()).max().unwrap_or_default();
        let complete_repeats = repeats.into_iter().filter(|(_, shares)| shares.len() == edges);
        let shares: Vec<Vec<EdgeShare>> =
            complete_repeats.map(|(_, shares)| shares.into_iter().flatten().collect()).collect();
        Self::new(labels, edges, &shares, totals)
    }

    /// Returns the lowest and the highest rate of an edge over all repeats.
    pub fn rate_range(&self) -> Option<(f64, f64)> {
        let rates = self.shares.iter().map(|share| (share.rate, share.rate));
        rates.reduce(|(lo, hi), (a, b)| (lo.min(a), hi.max(b)))
    }
}

impl EdgeShare {
    /// Returns the share of an edge over the whole length of its run, including warm-up; `None` for a run without length.
    pub fn from_run(answers: u64, seconds: f64, median: Option<f64>) -> Option<Self> {
        (seconds > 0.0).then(|| Self { rate: answers as f64 / seconds, median })
    }
}

impl Totals {
    fn from_values(totals: &SortedValues) -> Self {
        Self {
            count: totals.len(),
            mean: mean(totals.values().iter().copied()),
            median: totals.median(),
            p95: totals.p95(),
            p99: totals.p99(),
        }
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u64), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests;
