//! Reference to one of many rows.

use peernet_clock::{Interval, OneWayDelay, Span, Verdict};

use super::columns::{ColumnKind, FIXED_COLUMNS};
use super::{Column, Outcome, Row, Rows, WARM_UP};

/// Columns of the numbers of an upload's delay: its value, then its other properties.
const UPLOAD: [&str; 4] = ["upload", "upload-raw", "upload-lo", "upload-hi"];
/// Columns of the numbers of a download's delay, in the same order.
const DOWNLOAD: [&str; 4] = ["download", "download-raw", "download-lo", "download-hi"];

/// Reference to a row of [`Rows`](super::Rows): the content of a [`Row`], without a copy.
#[derive(Clone, Copy)]
pub struct RowRef<'a> {
    rows: &'a Rows,
    index: usize,
}

impl<'a> RowRef<'a> {
    pub(super) const fn new(rows: &'a Rows, index: usize) -> Self {
        Self { rows, index }
    }

    pub(super) const fn index(&self) -> usize {
        self.index
    }

    /// Returns the number in a column of `data.csv`; `None` if the cell is empty or text, or there is no such column.
    pub fn value(&self, column: &str) -> Option<f64> {
        if column == WARM_UP {
            return Some(f64::from(u8::from(self.warm_up())));
        }
        let column = *self.rows.column_indexes.get(column)?;
        self.rows.numbers[column].get(self.index)
    }

    /// Returns the number of the iteration in the run, from 1.
    pub fn iteration(&self) -> u64 {
        self.value("iteration").unwrap_or_default() as u64
    }

    /// Returns the intended start, seconds of the edge's wall clock since the Unix epoch; 0 if it was not recorded.
    pub fn at(&self) -> f64 {
        self.value("at").unwrap_or_default()
    }

    /// Returns the episode, from 0.
    pub fn episode(&self) -> u32 {
        self.value("episode").unwrap_or_default() as u32
    }

    /// Returns the step within the episode, from 0.
    pub fn step(&self) -> u32 {
        self.value("step").unwrap_or_default() as u32
    }

    /// Returns whether the iteration is warm-up. Such rows are stored, but left out of statistics.
    pub fn warm_up(&self) -> bool {
        self.rows.outcomes[self.index].1
    }

    /// Returns the outcome of the iteration.
    pub fn outcome(&self) -> Outcome {
        self.rows.outcomes[self.index].0
    }

    /// Returns whether statistics include the iteration: it succeeded and is not warm-up.
    pub fn is_in_statistics(&self) -> bool {
        self.outcome() == Outcome::Ok && !self.warm_up()
    }

    /// Returns the reason for a missing answer, if one was reported.
    pub fn reason(&self) -> Option<&'a str> {
        let reasons = &self.rows.reasons;
        let position = reasons.binary_search_by_key(&self.index, |(index, _)| *index).ok()?;
        Some(&reasons[position].1)
    }

    /// Returns the columns and values of the measurements. First come the columns that every `data.csv` has.
    pub fn values(&self) -> impl Iterator<Item = (&'a Column, f64)> {
        let Self { rows, index } = *self;
        // All columns after the fixed columns are measurements.
        let is_measurement = FIXED_COLUMNS.iter().map(|(_, kind)| *kind == ColumnKind::Node);
        let is_measurement = is_measurement.chain(std::iter::repeat(true));
        let columns = rows.names.iter().zip(&rows.numbers).zip(is_measurement);
        columns
            .filter(|(_, is_measurement)| *is_measurement)
            .filter_map(move |((name, numbers), _)| Some((name, numbers.get(index)?)))
    }

    /// Returns the delay from edge to cloud; `None` if no message was sent, or its delay was never judged.
    pub fn upload(&self) -> Option<OneWayDelay> {
        self.delay(0, UPLOAD)
    }

    /// Returns the delay from cloud to edge; `None` if no message was sent, or its delay was never judged.
    pub fn download(&self) -> Option<OneWayDelay> {
        self.delay(1, DOWNLOAD)
    }

    /// Returns the verdicts on both delays, upload and download.
    pub fn verdicts(&self) -> [Option<Verdict>; 2] {
        [0, 1].map(|direction: usize| self.rows.verdicts[direction][self.index].map(|(verdict, _)| verdict))
    }

    /// Returns whether a message was sent to the other host, and whether one was sent back.
    pub fn has_messages(&self) -> [bool; 2] {
        // A message has a verdict even if its delay is unknown. But results of other programs have delays and sizes
        // without verdicts.
        let has_message = |verdict: Option<Verdict>, delay: &str, bytes: &str| {
            verdict.is_some()
                || self.value(delay).is_some()
                || self.value(bytes).is_some_and(|bytes| bytes > 0.0)
        };
        let [up, down] = self.verdicts();
        [has_message(up, UPLOAD[0], "upload-bytes"), has_message(down, DOWNLOAD[0], "download-bytes")]
    }

    /// Returns whether a message was sent in the direction `upload` or `download`, but its delay is unknown.
    pub fn has_unknown_delay(&self, direction: &str) -> bool {
        let [up, down] = self.has_messages();
        self.value(direction).is_none() && if direction == UPLOAD[0] { up } else { down }
    }

    fn delay(&self, direction: usize, columns: [&str; 4]) -> Option<OneWayDelay> {
        let (verdict, source) = self.rows.verdicts[direction][self.index]?;
        let [value, raw, lo, hi] = columns.map(|column| self.value(column));
        let bounds = lo
            .zip(hi)
            // An interval must not be empty, but the file can have been edited by hand.
            .filter(|(lo, hi)| lo <= hi)
            .map(|(lo, hi)| Interval { lo: Span::from_seconds_f64(lo), hi: Span::from_seconds_f64(hi) });
        Some(OneWayDelay {
            raw: Span::from_seconds_f64(raw?),
            value: value.map(Span::from_seconds_f64),
            bounds,
            source,
            verdict,
        })
    }

    /// Returns a copy that does not refer to the other rows.
    pub fn to_row(self) -> Row {
        Row {
            iteration: self.iteration(),
            at: self.at(),
            episode: self.episode(),
            step: self.step(),
            warm_up: self.warm_up(),
            outcome: self.outcome(),
            reason: self.reason().map(str::to_owned),
            values: self.values().map(|(name, value)| (name.clone(), value)).collect(),
            upload: self.upload(),
            download: self.download(),
        }
    }
}

impl std::fmt::Debug for RowRef<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.to_row().fmt(f)
    }
}
