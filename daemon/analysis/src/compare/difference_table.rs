//! The differences between two lines of a comparison as a table.

use peernet_sample::printable_line;
use peernet_statistics::number::{EXACT, column_decimals, decimals, fixed_ms, is_exact};

use super::{Difference, Differences, EMPTY_CELL, StageDifference};
use crate::table::{CaptionedTable, Table, csv_text};

/// Maximum number of decimals of a number of ms: the last decimal is a microsecond. The clock of another host is never
/// known more precisely.
pub(super) const MAX_MS_DECIMALS: usize = 3;
/// Explanation of the intervals of means and medians.
const INTERVAL_MEANING: &str = "The interval says how far the difference would vary if the runs were \
     repeated immediately, under the same conditions (of means: Welch, from batch means; of medians: stationary bootstrap).";
/// Explanation of an interval of means.
pub(super) const MEAN_INTERVAL_MEANING: &str = "The interval says how far the difference would vary if the runs were \
     repeated immediately, under the same conditions (Welch, from batch means).";
/// Sentence on what no interval contains.
pub(super) const INTERVAL_LIMITATION: &str =
    "The interval does not contain changes from day to day; only repeats on several days show such changes.";

impl Differences {
    /// Returns the table for people, with a caption.
    pub fn captioned(&self) -> CaptionedTable {
        CaptionedTable { heading: self.heading(), table: self.table(), notes: self.notes() }
    }

    /// Returns CSV for programs: seconds, with all digits. The table has a row for each stage of each pair of lines.
    pub fn csv(differences: &[Self]) -> String {
        let rows = differences.iter().flat_map(|pair| pair.stages.iter().map(|stage| pair.csv_row(stage)));
        csv_text(&Self::CSV_HEADER, &rows.collect::<Vec<_>>())
    }

    const CSV_HEADER: [&'static str; 14] = [
        "baseline",
        "other",
        "stage",
        "baseline-mean",
        "other-mean",
        "mean-difference",
        "mean-difference-lo",
        "mean-difference-hi",
        "baseline-median",
        "other-median",
        "median-difference",
        "median-difference-lo",
        "median-difference-hi",
        "clocks",
    ];

    fn csv_row(&self, stage: &StageDifference) -> Vec<String> {
        let number = |number: Option<f64>| number.map(|number| number.to_string()).unwrap_or_default();
        let difference_cells = |difference: Difference| difference.value_and_ends().map(number);
        let value_cells = |values: (f64, f64)| [values.0.to_string(), values.1.to_string()];
        let names = [self.baseline.clone(), self.other.clone(), stage.stage.clone()].into_iter();
        let means = value_cells(stage.means).into_iter().chain(difference_cells(stage.mean_difference));
        let medians = value_cells(stage.medians).into_iter().chain(difference_cells(stage.median_difference));
        names.chain(means).chain(medians).chain([number(stage.clock_error)]).collect()
    }

    fn heading(&self) -> String {
        printable_line(&format!("A: {}. B: {}.", self.baseline, self.other)).into_owned()
    }

    fn table(&self) -> Table {
        let header = [
            "stage",
            "mean A",
            "mean B",
            "B − A",
            "95 % confidence",
            "median A",
            "median B",
            "B − A",
            "95 % confidence",
            "clocks",
        ];
        Table {
            header: header.map(str::to_owned).to_vec(),
            label_columns: 1,
            rows: self.rows(),
            marked: None,
        }
    }

    /// Returns a row for each stage. All numbers of a column have the same number of decimals.
    fn rows(&self) -> Vec<Vec<String>> {
        let stages = || self.stages.iter();
        let shared_decimals = |difference: fn(&StageDifference) -> Difference| {
            column_decimals(stages().map(|stage| difference(stage).margin()))
        };
        let mean_decimals = shared_decimals(|stage| stage.mean_difference);
        let median_decimals = shared_decimals(|stage| stage.median_difference);
        let clock_errors = stages().filter_map(|stage| stage.clock_error).filter(|error| *error > 0.0);
        let clock_decimals =
            clock_errors.map(|error| decimals(error * 1e3, 2).min(MAX_MS_DECIMALS)).max().unwrap_or_default();
        let cells = |values: (f64, f64), difference: Difference, decimals: usize| {
            let ms = |seconds: f64| fixed_ms(seconds, decimals);
            let (difference, interval) = difference.texts(decimals);
            let interval = interval.unwrap_or_else(|| EMPTY_CELL.to_owned());
            [ms(values.0), ms(values.1), difference, interval]
        };
        let clock_cell = |error: f64| {
            if is_exact(error) {
                return EXACT.to_owned();
            }
            format!("±{}", fixed_ms(error, clock_decimals))
        };
        let row = |stage: &StageDifference| {
            let name = std::iter::once(stage.stage.clone());
            let means = cells(stage.means, stage.mean_difference, mean_decimals);
            let medians = cells(stage.medians, stage.median_difference, median_decimals);
            let clocks = stage.clock_error.map(clock_cell).unwrap_or_default();
            name.chain(means).chain(medians).chain([clocks]).collect()
        };
        stages().map(row).collect()
    }

    fn notes(&self) -> String {
        let clocks = if self.stages.iter().any(|stage| stage.clock_error.is_some_and(|error| error > 0.0)) {
            " The interval does not contain the uncertainty of the clock offset, which is in the last column."
        } else {
            ""
        };
        format!("In ms. {INTERVAL_MEANING}{clocks} {INTERVAL_LIMITATION}")
    }
}
