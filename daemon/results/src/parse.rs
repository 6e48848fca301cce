//! Parser of `data.csv`.

use std::fs::File;
use std::path::Path;

use peernet_analysis::rows::{
    Column, ColumnKind, FIXED_COLUMNS, Outcome, PUBLISHED_COLUMN_COUNT, RowBuilder, Rows, column,
    published_stages,
};
use peernet_clock::{DelaySource, Verdict};
use peernet_logger::csv::{self as data_csv, column_name, ends_with_line};

/// Defect of a file of rows.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ParseError {
    #[error("{0}")]
    Io(#[from] std::io::Error),
    #[error("{0}")]
    Csv(#[from] csv::Error),
    #[error("it has no column of a run, such as sensing, inference or total")]
    NoNodeColumn,
    #[error("line {line}, column {column}: {cell:?} is not {expected}")]
    Cell { line: u64, column: String, cell: String, expected: &'static str },
}

/// State of reading a file line by line.
pub(crate) struct RowParser {
    columns: Vec<ColumnParser>,
    /// True if the file has no sum of the stages. The parser then adds the sum.
    needs_sum: bool,
    rows: Rows,
}

/// Column of the file.
struct ColumnParser {
    name: Column,
    /// Kind of the column; `None` if it is not one of the fixed columns.
    kind: Option<ColumnKind>,
    /// Index among the [`published_stages`], if the column is one of them.
    stage: Option<usize>,
    /// Index of the column's numbers in a row; `None` until the first number was read.
    index: Option<usize>,
    /// True if the numbers of the column are stored.
    is_wanted: bool,
}

impl RowParser {
    /// Reads all rows, with the columns that `wanted` accepts. The second value says whether the file has a column that
    /// marks the rows of the warm-up. Without such a column, the first `warm_up` rows are the warm-up.
    ///
    /// If this program wrote the file, a truncated last line is ignored: the program was killed while it wrote the line.
    pub(crate) fn read_rows(
        path: &Path,
        warm_up: usize,
        wanted: &dyn Fn(&str) -> bool,
    ) -> Result<(Rows, bool), ParseError> {
        let mut file = File::open(path)?;
        let ends_with_line = ends_with_line(&mut file)?;
        let mut reader = csv::Reader::from_reader(file);
        let kind = |name: &str| FIXED_COLUMNS.iter().find(|(fixed, _)| *fixed == name).map(|(_, kind)| *kind);
        let column_parser = |name: &str| {
            let name = column_name(name);
            ColumnParser {
                name: column(name),
                kind: kind(name),
                stage: published_stages().position(|stage| stage == name),
                index: None,
                is_wanted: wanted(name),
            }
        };
        let columns: Vec<ColumnParser> = reader.headers()?.iter().map(column_parser).collect();
        let has = |name: &str| columns.iter().any(|column| column.name == name);
        if !columns.iter().any(|column| matches!(column.kind, Some(ColumnKind::Node))) {
            return Err(ParseError::NoNodeColumn);
        }
        // Only this program writes the column `outcome`.
        let (has_warm_up_column, is_of_this_program, needs_sum) =
            (has("warm-up"), has("outcome"), !has("stages-total"));
        let mut parser = Self { columns, needs_sum, rows: Rows::default() };
        // Other programs and editors may leave out the line feed after a complete last line.
        let is_truncated = is_of_this_program && !ends_with_line;
        let mut records = reader.into_records().peekable();
        while let Some(record) = records.next() {
            if is_truncated && records.peek().is_none() {
                break;
            }
            let is_warm_up = !has_warm_up_column && parser.rows.len() < warm_up;
            parser.parse_row(&record?, is_warm_up)?;
        }
        Ok((parser.rows, has_warm_up_column))
    }

    fn parse_row(&mut self, record: &csv::StringRecord, is_warm_up: bool) -> Result<(), ParseError> {
        let line = record.position().map_or(0, csv::Position::line);
        let Self { columns, rows, .. } = self;
        let mut row = rows.build_row();
        row.warm_up = is_warm_up;
        // Verdict and source of each delay: the upload at index 0, the download at index 1.
        let mut verdicts = [(None, None); 2];
        let mut stages = [None; PUBLISHED_COLUMN_COUNT];
        for (column_parser, text) in columns.iter_mut().zip(record) {
            let cell = text.trim();
            if cell.is_empty() || column_parser.is_ignored() {
                continue;
            }
            let invalid_cell = |expected| ParseError::Cell {
                line,
                column: column_parser.name.to_string(),
                cell: cell.to_owned(),
                expected,
            };
            if column_parser.is_text() {
                let verdict_and_source =
                    &mut verdicts[usize::from(column_parser.name.starts_with("download"))];
                store_text(&mut row, verdict_and_source, &column_parser.name, text)
                    .ok_or_else(|| invalid_cell("an outcome, verdict or source"))?;
                continue;
            }
            if column_parser.name == "warm-up" {
                row.warm_up = data_csv::is_warm_up(cell).ok_or_else(|| invalid_cell("a number"))?;
                continue;
            }
            let number = match cell.parse::<f64>() {
                Ok(number) => number,
                // A text in a column that a person added is ignored.
                Err(_) if column_parser.kind.is_none() => continue,
                Err(_) => return Err(invalid_cell("a number")),
            };
            if let Some(stage) = column_parser.stage {
                stages[stage] = Some(number);
            }
            match column_parser.name.as_ref() {
                // 0 means that the start was not recorded.
                "at" if number == 0.0 => {}
                _ if column_parser.is_wanted && column_parser.is_meaningful(number) => {
                    let index = *column_parser
                        .index
                        .get_or_insert_with(|| row.column_index(rows, &column_parser.name));
                    row.numbers[index] = Some(number);
                }
                _ => {}
            }
        }
        row.verdicts = verdicts.map(|(verdict, source)| verdict.zip(source));
        // A row without an iteration number gets its position in the file.
        let number = rows.len() as f64 + 1.0;
        let iteration = row.column_index(rows, &column("iteration"));
        row.numbers[iteration].get_or_insert(number);
        // A stage that the row does not have is left out of the sum.
        let sum: Option<f64> = stages.into_iter().flatten().reduce(|sum, stage| sum + stage);
        if let Some(sum) = sum.filter(|sum| self.needs_sum && sum.is_finite()) {
            let index = row.column_index(rows, &column("stages-total"));
            row.numbers[index] = Some(sum);
        }
        rows.push_built(row);
        Ok(())
    }
}

impl ColumnParser {
    /// Returns whether the column contains text.
    fn is_text(&self) -> bool {
        self.kind == Some(ColumnKind::Text)
    }

    /// Returns whether the number is meaningful. Infinity is meaningful only as an upper bound.
    fn is_meaningful(&self, number: f64) -> bool {
        number.is_finite() || (number == f64::INFINITY && self.name.ends_with("-hi"))
    }

    /// Returns whether the column is ignored: it is not one of the fixed columns, and it is not wanted.
    fn is_ignored(&self) -> bool {
        self.kind.is_none() && !self.is_wanted
    }
}

/// Stores the text of a cell. Returns `None` if the text is not valid in the column.
fn store_text(
    row: &mut RowBuilder,
    verdict_and_source: &mut (Option<Verdict>, Option<DelaySource>),
    column: &str,
    text: &str,
) -> Option<()> {
    let cell = text.trim();
    match column.rsplit_once('-').map_or(column, |(_, last)| last) {
        "outcome" => row.outcome = Some(Outcome::from_name(cell)?),
        "verdict" => verdict_and_source.0 = Some(Verdict::from_name(cell)?),
        "source" => verdict_and_source.1 = Some(DelaySource::from_name(cell)?),
        _ => row.reason = Some(text.to_owned()),
    }
    Some(())
}
