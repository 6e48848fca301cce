//! Summary of a run's columns: the *Tabulated Metrics* of the paper.

mod scale;

pub use scale::Scale;

use std::collections::BTreeMap;

use peernet_logger::stage;
use peernet_statistics::{self as statistics, Moments};

use crate::accuracy::{ACCURACIES, Accuracy, UnknownLabels};
use crate::actuator_results::{ACTION_REPORTS, ActuatorResults, EPISODE_SUCCESS, EPISODE_VALUES, SUPERSEDED};
use crate::deadline::{DEADLINE_MISSED, Misses};
use crate::delays::median_bounds;
use crate::order::SortedValues;
use crate::outcomes::failed_in_warm_up;
use crate::record::{Clocks, Counts, RunRecord};
use crate::rows::{Column, ColumnKind, FIXED_COLUMNS, Rows, SKIPPED_STARTS, Units};
use crate::trust::{ReplayedLatencies, Starts};

/// Summary of the columns of a run. Warm-up and failed iterations are left out, with two
/// exceptions: failed iterations count as missed deadlines, and the values of episodes count in all
/// iterations.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Title for people.
    pub title: String,
    /// Summaries of the columns with at least one number that counts, in the order of `data.csv`.
    pub quantities: Vec<Quantity>,
    /// Number of iterations by outcome.
    pub counts: Counts,
    /// Number of warm-up iterations that failed. `counts` has these iterations in `warm_up`, not among the failed
    /// iterations.
    pub failed_in_warm_up: u64,
    /// Deadline of an iteration, seconds; `None` without a deadline.
    pub deadline_s: Option<f64>,
    /// Number of iterations that missed the deadline; `None` without a deadline.
    pub misses: Option<Misses>,
    /// Superseded answers, and success and return of the episodes.
    pub actuator: ActuatorResults,
    /// Numbers of actual and of skipped starts of an open loop.
    pub starts: Starts,
    /// Description of the distribution that the latencies of the model are drawn from; `None` if the latencies are
    /// measured.
    pub replayed: Option<String>,
    /// Quality of the delays: their verdicts, sources and bounds.
    pub clocks: Clocks,
    /// Accuracy of the model, by column; empty if the right answers are not known.
    pub accuracy: BTreeMap<String, Accuracy>,
    /// Samples whose label is not a class of the model. Their answers are neither right nor wrong.
    pub unknown_labels: Option<UnknownLabels>,
    /// Units of the columns that the run logged in addition to the standard columns.
    pub units: Units,
}

/// Summary of one column, in the column's unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// Name of the column.
    pub column: Column,
    /// Number of values.
    pub count: u64,
    /// Mean of the values.
    pub mean: f64,
    /// Sample standard deviation; `None` below two values.
    pub std: Option<f64>,
    /// Median. All quantiles are computed by linear interpolation between neighbours (definition 7 of Hyndman and Fan
    /// 1996, numpy's default).
    pub median: f64,
    /// 95th percentile; `None` below 60 values.
    pub p95: Option<f64>,
    /// 99th percentile; `None` below 300 values.
    pub p99: Option<f64>,
    /// Largest value.
    pub max: f64,
    /// Bounds that contain the median of the true values; the upper bound may be infinite. `None` if the column has no
    /// bounds.
    pub bounds: Option<(f64, f64)>,
}

impl Summary {
    /// Returns the summary of these rows, without the facts of their run.
    pub fn from_rows(rows: &Rows) -> Self {
        // Bounds are not summarised. The bounds of delays are left out by their kind. The bounds of throughputs have
        // the kind `Node` and are left out by their names.
        let summarised_columns = rows.names().iter().enumerate().filter(|(index, name)| {
            FIXED_COLUMNS.get(*index).is_none_or(|(_, kind)| *kind == ColumnKind::Node)
                && !is_throughput_bound(name)
        });
        let quantity = |(_, name): (usize, &Column)| {
            // Failed iterations missed their deadline, too. They are included, so that the mean of the column is the
            // miss rate.
            if *name == DEADLINE_MISSED {
                let without_warm_up = rows.iter().filter(|row| !row.warm_up());
                return Quantity::from_values(
                    name.clone(),
                    without_warm_up.filter_map(|row| row.value(name)),
                );
            }
            // The values of episodes count in all iterations.
            if EPISODE_VALUES.contains(&name.as_ref()) {
                return Quantity::from_values(name.clone(), rows.iter().filter_map(|row| row.value(name)));
            }
            let quantity = Quantity::from_values(name.clone(), rows.values_in_statistics(name))?;
            Some(Quantity { bounds: median_bounds_of(rows, name), ..quantity })
        };
        Self {
            title: String::new(),
            quantities: summarised_columns.filter_map(quantity).collect(),
            counts: Counts::from_rows(rows, 0),
            failed_in_warm_up: failed_in_warm_up(rows),
            deadline_s: None,
            misses: Misses::from_rows(rows),
            actuator: ActuatorResults::from_rows(rows),
            starts: Starts::from_rows(rows),
            replayed: None,
            clocks: Clocks::from_rows(rows),
            accuracy: Accuracy::by_column(rows),
            unknown_labels: UnknownLabels::from_rows(rows, &[]),
            units: Units::default(),
        }
    }

    /// Returns the summary of a run. Its record has the title, the deadline, the units of further columns, the number
    /// of iterations that have no row, replayed latencies, and examples of labels and classes.
    pub fn from_run(record: &RunRecord, rows: &Rows) -> Self {
        let summary = Self::from_rows(rows);
        Self {
            title: record.title.clone(),
            units: record.units.clone(),
            counts: Counts { unseen: record.counts.unseen, ..summary.counts },
            deadline_s: record.deadline_s,
            replayed: ReplayedLatencies::from_run(&record.facts, rows).map(|replayed| replayed.describe()),
            unknown_labels: UnknownLabels::from_rows(rows, &record.facts),
            ..summary
        }
    }

    /// Returns the summary of one column; `None` if no number in the column counts.
    pub fn quantity(&self, column: &str) -> Option<&Quantity> {
        self.quantities.iter().find(|quantity| quantity.column == column)
    }
}

/// Returns whether the values with this name are reported as a count or a share. Tables of quantities leave them out,
/// because quantiles of such values have little meaning.
pub fn is_reported_as_count(name: &str) -> bool {
    let names = [SKIPPED_STARTS, DEADLINE_MISSED, SUPERSEDED, EPISODE_SUCCESS];
    names.iter().chain(&ACTION_REPORTS).chain(&ACCURACIES).any(|count| *count == name)
        || stage::UNKNOWN_LABEL == *name
}

/// Returns whether a column contains the lower or the upper bounds of the throughputs in another column.
fn is_throughput_bound(column: &str) -> bool {
    column.ends_with("-throughput-lo") || column.ends_with("-throughput-hi")
}

/// Returns the [bounds of the median](median_bounds) of a column; `None` unless every value in the statistics has
/// bounds.
pub fn median_bounds_of(rows: &Rows, column: &str) -> Option<(f64, f64)> {
    let columns_with_bounds = ["upload", "download", "upload-throughput", "download-throughput"];
    columns_with_bounds.contains(&column).then_some(())?;
    let [lower, upper] = ["lo", "hi"].map(|suffix| format!("{column}-{suffix}"));
    let with_values = rows.iter().filter(|row| row.is_in_statistics() && row.value(column).is_some());
    median_bounds(with_values.map(|row| row.value(&lower).zip(row.value(&upper))))
}

impl Quantity {
    /// Returns the summary of these numbers; `None` if there are none. Numbers that are not finite, or too large for
    /// statistics, are left out.
    pub fn from_values(column: Column, values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let values = values.into_iter().filter(|value| statistics::Summary::accepts(*value));
        let values: Vec<f64> = values.collect();
        let moments: Moments = values.iter().copied().collect();
        let ordered: SortedValues = values.into_iter().collect();
        Some(Self {
            column,
            count: moments.count,
            mean: moments.mean,
            std: moments.std(),
            median: ordered.median()?,
            p95: ordered.p95(),
            p99: ordered.p99(),
            max: moments.max,
            bounds: None,
        })
    }
}

#[cfg(test)]
mod tests;
