//! Tables of the statistics of edges that use one cloud at the same time.

use peernet_statistics::number::{
    NONE as EMPTY_CELL, count, fixed_or_less_than, join_ends, milliseconds, rate,
};

use super::{Users, UsersLine};
use crate::compare::{csv_labels, readable_names, replayed_configurations};
use crate::table::{Table, csv_text};

/// Sentence on the time whose answers are counted.
pub const COUNTED_TIME: &str = "Answers are counted only while all edges of a repeat were measuring.";

/// Sentence that explains the column of the fairness.
pub const FAIRNESS_MEANING: &str = "Fairness is Jain's index of the edges' rates: 1 if all edges have the same rate, 1/n if one \
                                    of n edges gets everything.";

impl Users {
    /// Names of the columns of the CSV after the axes.
    pub const CSV_COLUMNS: [&'static str; 11] = [
        "edges",
        "rate",
        "rate-least",
        "rate-most",
        "fairness",
        "count",
        "total-mean",
        "total-p50",
        "total-p95",
        "total-p99",
        "replayed",
    ];

    /// Returns the text for a terminal.
    pub fn text(&self) -> String {
        format!("{}\n\n{}", self.table().text(), self.notes().join("\n"))
    }

    /// Returns Markdown.
    pub fn markdown(&self) -> String {
        format!("{}\n{}\n", self.table().markdown(), self.notes().join("\n"))
    }

    /// Returns LaTeX for the package booktabs.
    pub fn latex(&self) -> String {
        self.table().latex(&self.notes().join(" "))
    }

    /// Returns CSV for programs: seconds and answers per second, with all digits.
    pub fn csv(&self) -> String {
        let header: Vec<&str> = self.axes.iter().map(String::as_str).chain(Self::CSV_COLUMNS).collect();
        let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        let row = |line: &UsersLine| {
            let mut cells = csv_labels(&line.labels);
            let (least, most) = line.rate_range().unzip();
            cells.push(line.edges.to_string());
            cells.extend([line.rate, least, most, line.fairness].map(number));
            cells.push(line.totals.count.to_string());
            cells.extend(latencies(line).map(number));
            cells.push(u8::from(line.replayed.is_some()).to_string());
            cells
        };
        csv_text(&header, &self.lines.iter().map(row).collect::<Vec<_>>())
    }

    /// Returns the notes below the table.
    fn notes(&self) -> Vec<String> {
        let names = readable_names(&self.axes, self.lines.iter().map(|line| line.labels.as_slice()));
        let lines = names.into_iter().zip(self.lines.iter().map(|line| line.replayed.as_deref()));
        std::iter::once(format!("{COUNTED_TIME} {FAIRNESS_MEANING}"))
            .chain(replayed_configurations(lines))
            .collect()
    }

    fn table(&self) -> Table {
        let mut header = self.axes.clone();
        let label_columns = header.len();
        header.extend(["edges", "answers/s", "answers/s per edge", "fairness"].map(str::to_owned));
        header.extend(["mean ms", "p50 ms", "p95 ms", "p99 ms"].map(|name| format!("total {name}")));
        let row = |line: &UsersLine| {
            let quantiles = [line.totals.median, line.totals.p95, line.totals.p99];
            let quantiles = quantiles.map(|value| cell(value, milliseconds));
            line.labels.iter().cloned().chain(line.cell_texts()).chain(quantiles).collect()
        };
        Table { header, label_columns, rows: self.lines.iter().map(row).collect(), marked: None }
    }
}

impl UsersLine {
    /// Returns the texts of five cells: the number of edges, the rate, the range of the edges' rates, the fairness, and
    /// the mean total in ms.
    pub fn cell_texts(&self) -> [String; 5] {
        let range = self.rate_range().map(|(least, most)| join_ends([least, most].map(rate)));
        [
            count(self.edges as u64),
            cell(self.rate, rate),
            range.unwrap_or_else(|| EMPTY_CELL.to_owned()),
            cell(self.fairness, |index| fixed_or_less_than(index, 3)),
            cell(self.totals.mean, milliseconds),
        ]
    }
}

fn cell(value: Option<f64>, format: fn(f64) -> String) -> String {
    value.map_or_else(|| EMPTY_CELL.to_owned(), format)
}

/// Returns mean, median, 95th and 99th percentile of the totals, seconds.
fn latencies(line: &UsersLine) -> [Option<f64>; 4] {
    [line.totals.mean, line.totals.median, line.totals.p95, line.totals.p99]
}
