//! Statistics of edges that use one cloud at the same time (*users* of an experiment): latency against the number of
//! users, and fairness.
//!
//! ```text
//! Loaded ── concurrent_edges ──┐
//!                              Repeat ── UsersLine ── Users ─┬─ text, Markdown, LaTeX, CSV
//! stored rows and roll-ups ────┘                             └─ curves   latency against the number of edges
//! ```

mod curves;
mod tables;

pub use curves::Curve;
pub use tables::{COUNTED_TIME, FAIRNESS_MEANING};

use peernet_statistics::Summary;

use crate::compare::{Configurations, group_by_labels};
use crate::concurrent_edges::{complete_groups, concurrent_groups};
use crate::loaded::Loaded;
use crate::order::{SortedValues, mean};
use crate::rows::RowRef;
use crate::total_column::TotalColumn;
use crate::trust::{ReplayedLatencies, StartsSoFar, start_time};

/// Returns Jain's index of fairness, (Σx)² / (n Σx²) (Jain, Chiu and Hawe 1984, *A Quantitative Measure of Fairness and
/// Discrimination for Resource Allocation in Shared Computer Systems*, DEC-TR-301). The index is 1/n if one of n users
/// gets everything, and 1 if all users get the same. `None` if all shares are 0, or if there is no share.
pub fn jain_index(shares: &[f64]) -> Option<f64> {
    let (sum, squares) = shares.iter().fold((0.0, 0.0), |(sum, squares), x| (sum + x, squares + x * x));
    // Because of rounding, the index of equal shares can be a little more than 1.
    (squares > 0.0).then(|| (sum * sum / (shares.len() as f64 * squares)).min(1.0))
}

/// Results of configurations in which one or several edges use the cloud at the same time.
#[derive(Clone, Debug, PartialEq)]
pub struct Users {
    /// Names of the columns that distinguish the lines, as in the comparison of the same runs.
    pub axes: Vec<String>,
    /// One line for each configuration, in the order of the input.
    pub lines: Vec<UsersLine>,
}

/// Results of one configuration, in seconds and in answers per second.
#[derive(Clone, Debug, PartialEq)]
pub struct UsersLine {
    /// Labels that distinguish the configuration: as many as there are axes.
    pub labels: Vec<String>,
    /// Number of edges that measured at the same time.
    pub edges: usize,
    /// Answers per second of all edges together, on average over the repeats; `None` if the edges never measured at the
    /// same time.
    pub rate: Option<f64>,
    /// [`jain_index`] of the edges' rates, on average over the repeats; `None` without rates.
    pub fairness: Option<f64>,
    /// Performance of each edge in each repeat with a common time.
    pub edge_performances: Vec<EdgePerformance>,
    /// Summary of the totals of all edges together.
    pub totals: Totals,
    /// Distribution that the latencies of the model are drawn from; `None` if all latencies are measured.
    pub replayed: Option<String>,
}

/// One repeat of a configuration: what its edges measured while all of them were measuring. `T` holds the totals of an
/// edge.
#[derive(Clone, Debug, PartialEq)]
pub struct Repeat<T> {
    /// Length of the [common time](common_time), seconds; `None` if the edges never measured at the same time.
    pub common_seconds: Option<f64>,
    /// Measurements of each edge; empty without a common time.
    pub edges: Vec<EdgeMeasurements<T>>,
}

/// Measurements of one edge within the common time.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeMeasurements<T> {
    /// Number of answered iterations that started in the common time.
    pub starts: u64,
    /// Totals of these iterations, seconds.
    pub totals: T,
}

/// Totals of an edge: single values, or a summary with quantiles within 1 %.
pub trait EdgeTotals {
    /// Returns the median; `None` without totals.
    fn median(&self) -> Option<f64>;

    /// Returns the summary of the totals of several edges together.
    fn summarise<'a>(edges: impl Iterator<Item = &'a Self>) -> Totals
    where
        Self: 'a;
}

impl EdgeTotals for SortedValues {
    fn median(&self) -> Option<f64> {
        Self::median(self)
    }

    fn summarise<'a>(edges: impl Iterator<Item = &'a Self>) -> Totals {
        let totals: Self = edges.flat_map(Self::values).copied().collect();
        Totals {
            count: totals.len(),
            mean: mean(totals.values().iter().copied()),
            median: totals.median(),
            p95: totals.p95(),
            p99: totals.p99(),
        }
    }
}

impl EdgeTotals for Summary {
    fn median(&self) -> Option<f64> {
        self.quantile(0.5)
    }

    fn summarise<'a>(edges: impl Iterator<Item = &'a Self>) -> Totals {
        let mut totals = Self::default();
        edges.for_each(|edge| totals.merge(edge));
        Totals {
            count: usize::try_from(totals.count()).unwrap_or(usize::MAX),
            mean: (totals.count() > 0).then_some(totals.moments.mean),
            median: totals.median(),
            p95: totals.p95(),
            p99: totals.p99(),
        }
    }
}

/// Returns the beginning and the end of the time in which all edges were measuring. Each item of
/// `edges` has the starts of an edge's first and last answered iteration after the warm-up, in the
/// order of the iteration numbers; `None` for an edge without such iterations. The common time
/// lasts from the latest of the first starts to the earliest of the last starts. Returns `None` if
/// there is no such time.
///
/// For a rate, the number of starts must equal the number of periods within the time. A start at the end of the time is
/// therefore not counted.
pub fn common_time<T: Ord + Copy>(edges: impl IntoIterator<Item = Option<(T, T)>>) -> Option<(T, T)> {
    let edges: Vec<(T, T)> = edges.into_iter().collect::<Option<_>>()?;
    let common = edges.into_iter().reduce(|a, b| (a.0.max(b.0), a.1.min(b.1)))?;
    (common.1 > common.0).then_some(common)
}

/// Returns what the edges of a repeat measured while all of them were measuring.
fn repeat_from_edges(edges: &[&Loaded]) -> Repeat<SortedValues> {
    let rows: Vec<Vec<RowRef<'_>>> =
        edges.iter().map(|edge| edge.rows.iter().filter(RowRef::is_in_statistics).collect()).collect();
    let measured_time = |rows: &Vec<RowRef<'_>>| {
        let mut starts = StartsSoFar::default();
        rows.iter().for_each(|row| starts.add(row.iteration(), row.at()));
        starts.times().first.zip(starts.times().last)
    };
    let Some((from, to)) = common_time(rows.iter().map(measured_time)) else {
        return Repeat { common_seconds: None, edges: Vec::new() };
    };
    let edge = |rows: &Vec<RowRef<'_>>| {
        let within = rows.iter().filter(|row| (from..to).contains(&start_time(row.at())));
        EdgeMeasurements {
            starts: within.clone().count() as u64,
            totals: within.filter_map(|row| row.value(TotalColumn::Measured.name())).collect(),
        }
    };
    Repeat { common_seconds: Some((to - from).seconds()), edges: rows.iter().map(edge).collect() }
}

/// Rate and latency of one edge while all edges were measuring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePerformance {
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
    /// Mean of the totals; `None` without totals.
    pub mean: Option<f64>,
    /// Median of the totals; `None` without totals.
    pub median: Option<f64>,
    /// 95th percentile; `None` below 60 totals.
    pub p95: Option<f64>,
    /// 99th percentile; `None` below 300 totals.
    pub p99: Option<f64>,
}

impl Users {
    /// Returns the statistics of runs, one run for each edge. The records of the runs tell which edges measured at the
    /// same time. `None` if no two edges did.
    pub fn from_runs(runs: &[Loaded]) -> Option<Self> {
        let indices: Vec<usize> = (0..runs.len()).collect();
        let position_of = |run: &usize| runs[*run].record.experiment.as_ref();
        let concurrent_groups = concurrent_groups(&indices, position_of, |run| &runs[*run].record.edge.name);
        let concurrent_groups = complete_groups(concurrent_groups, position_of);
        if concurrent_groups.iter().all(|edges| edges.len() <= 1) {
            return None;
        }
        // The columns are those of the comparison of the same runs. Groups with equal labels are repeats of one
        // configuration, and concurrent edges have equal labels.
        let Configurations { axes, labels } = Configurations::from_runs(runs);
        let labels: Vec<Vec<String>> =
            concurrent_groups.iter().map(|edges| labels[*edges[0]].clone()).collect();
        let line = |groups: Vec<usize>| {
            let line_labels = labels[groups[0]].clone();
            let edges_of = |group: &usize| concurrent_groups[*group].iter().map(|run| &runs[**run]).collect();
            let groups: Vec<Vec<&Loaded>> = groups.iter().map(edges_of).collect();
            let repeats: Vec<Repeat<SortedValues>> =
                groups.iter().map(|edges| repeat_from_edges(edges)).collect();
            let line_runs = || groups.iter().flatten();
            let all_totals = || {
                line_runs()
                    .flat_map(|run| run.rows.values_in_statistics(TotalColumn::Measured.name()))
                    .collect()
            };
            // All groups are complete, so the first group has as many edges as the others.
            let line = UsersLine::new(line_labels, groups[0].len(), &repeats, all_totals);
            let replayed =
                line_runs().filter_map(|run| ReplayedLatencies::from_run(&run.record.facts, &run.rows));
            UsersLine { replayed: ReplayedLatencies::describe_all(replayed), ..line }
        };
        Some(Self { axes, lines: group_by_labels(&labels).into_iter().map(line).collect() })
    }
}

impl UsersLine {
    /// Returns the line of a configuration with `edges` edges, from its repeats. `all_totals` returns the measured
    /// totals of all its iterations in the statistics. The field `replayed` is `None`: the repeats do not tell which
    /// latencies are replayed.
    pub fn new<T: EdgeTotals>(
        labels: Vec<String>,
        edges: usize,
        repeats: &[Repeat<T>],
        all_totals: impl FnOnce() -> T,
    ) -> Self {
        // A single edge shares its time with nobody, so all its totals count, and the numbers are those of the
        // comparison of all configurations.
        let totals = if edges == 1 {
            T::summarise(std::iter::once(&all_totals()))
        } else {
            T::summarise(repeats.iter().flat_map(|repeat| &repeat.edges).map(|edge| &edge.totals))
        };
        let performances_of = |repeat: &Repeat<T>| -> Vec<EdgePerformance> {
            let Some(seconds) = repeat.common_seconds else { return Vec::new() };
            let performance = |edge: &EdgeMeasurements<T>| EdgePerformance {
                rate: edge.starts as f64 / seconds,
                median: edge.totals.median(),
            };
            repeat.edges.iter().map(performance).collect()
        };
        // The performances of the edges of each repeat.
        let performances: Vec<Vec<EdgePerformance>> =
            repeats.iter().map(performances_of).filter(|edges| !edges.is_empty()).collect();
        let rates_of =
            |edges: &Vec<EdgePerformance>| edges.iter().map(|edge| edge.rate).collect::<Vec<f64>>();
        let rates: Vec<Vec<f64>> = performances.iter().map(rates_of).collect();
        Self {
            labels,
            edges,
            // The edges of one repeat share the cloud, so their rates are added up. Repeats were measured one after the
            // other, so the sums are averaged.
            rate: mean(rates.iter().map(|rates| rates.iter().sum())),
            fairness: mean(rates.iter().filter_map(|rates| jain_index(rates))),
            edge_performances: performances.concat(),
            totals,
            replayed: None,
        }
    }

    /// Returns the lowest and the highest rate of an edge over all repeats; `None` without rates.
    pub fn rate_range(&self) -> Option<(f64, f64)> {
        let rates = self.edge_performances.iter().map(|edge| (edge.rate, edge.rate));
        rates.reduce(|(lo, hi), (a, b)| (lo.min(a), hi.max(b)))
    }
}

#[cfg(test)]
mod tests;
