//! Rows as lines of comma-separated values (RFC 4180, with a line feed at the end of each line).

use std::collections::HashSet;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use peernet_analysis::rows::{Column, ColumnKind, FIXED_COLUMNS, Row, Rows};
use peernet_clock::OneWayDelay;

/// Columns of a `data.csv`: the fixed columns, then the columns of the run's further measurements.
#[derive(Clone, Debug)]
pub struct Header {
    names: Vec<Column>,
    name_set: HashSet<Column>,
}

impl Default for Header {
    fn default() -> Self {
        let names: Vec<Column> = FIXED_COLUMNS.iter().map(|(name, _)| Column::Borrowed(*name)).collect();
        Self { name_set: names.iter().cloned().collect(), names }
    }
}

impl Header {
    /// Returns the columns that these rows need.
    pub(crate) fn for_rows(rows: &Rows) -> Self {
        let names = rows.names().to_vec();
        Self { name_set: names.iter().cloned().collect(), names }
    }

    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.names.iter().map(AsRef::as_ref)
    }

    /// Returns whether every value of the row has a column.
    pub(crate) fn covers(&self, row: &Row) -> bool {
        row.values.iter().all(|(name, _)| self.name_set.contains(name))
    }

    /// Appends the columns that the row has and the header does not.
    pub fn add(&mut self, row: &Row) {
        for (name, _) in &row.values {
            if self.name_set.insert(name.clone()) {
                self.names.push(name.clone());
            }
        }
    }

    /// Returns the columns after the fixed columns.
    pub(crate) fn further_columns(&self) -> &[Column] {
        self.names.get(FIXED_COLUMNS.len()..).unwrap_or_default()
    }

    /// Appends the line of column names to `out`.
    pub fn write_header(&self, out: &mut Vec<u8>) {
        write_line(out, self.names());
    }

    /// Appends the line of a row to `out`. Values without a column are left out.
    pub fn write_row(&self, out: &mut Vec<u8>, row: &Row) {
        let fixed = FIXED_COLUMNS.iter().map(|(name, kind)| match kind {
            ColumnKind::Text => text_cell(row, name),
            ColumnKind::Node | ColumnKind::Property => number_cell(row.value(name)),
        });
        write_line(out, fixed.chain(self.further_columns().iter().map(|name| number_cell(row.value(name)))));
    }
}

/// Appends a line of cells to `out`. A cell with a comma, a quote or a line break is quoted.
fn write_line(out: &mut Vec<u8>, cells: impl Iterator<Item = impl AsRef<str>>) {
    for (index, cell) in cells.enumerate() {
        let cell = cell.as_ref();
        if index > 0 {
            out.push(b',');
        }
        if cell.contains([',', '"', '\n', '\r']) {
            out.push(b'"');
            out.extend(cell.replace('"', "\"\"").bytes());
            out.push(b'"');
        } else {
            out.extend(cell.bytes());
        }
    }
    out.push(b'\n');
}

fn text_cell(row: &Row, name: &str) -> String {
    let verdict = |delay: Option<OneWayDelay>| delay.map_or("", |delay| delay.verdict.name()).to_owned();
    let source = |delay: Option<OneWayDelay>| delay.map_or("", |delay| delay.source.name()).to_owned();
    match name {
        "outcome" => row.outcome.name().to_owned(),
        "upload-verdict" => verdict(row.upload),
        "upload-source" => source(row.upload),
        "download-verdict" => verdict(row.download),
        "download-source" => source(row.download),
        _ => row.reason.clone().unwrap_or_default(),
    }
}

/// Returns the shortest text that reads back as the same number; empty for an unknown number.
fn number_cell(value: Option<f64>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

/// Copies the rows of a file to a new file with another header. Empty cells are appended to each row for the columns that
/// the old file does not have.
pub(crate) fn pad_rows(from: &Path, to: &Path, header: &Header) -> io::Result<()> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_path(from)?;
    let mut out = BufWriter::new(std::fs::File::create(to)?);
    let mut bytes = Vec::new();
    header.write_header(&mut bytes);
    for record in reader.records().skip(1) {
        let record = record?;
        let missing = header.names.len().saturating_sub(record.len());
        write_line(&mut bytes, record.iter().chain(std::iter::repeat_n("", missing)));
        out.write_all(&bytes)?;
        bytes.clear();
    }
    out.write_all(&bytes)?;
    // The caller renames the copy over the original; after a power failure, an unsynced copy could be empty.
    out.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()
}
