//! Lines of `data.csv` as rows.

use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict};

use super::columns::{self, FIXED, Holds};
use super::{Column, Outcome, Row};
use crate::Passage;

/// The published stages, whose sum the paper calls Total.
const PUBLISHED_STAGES: [&str; 6] =
    ["sensing", "upload", "preprocessing", "inference", "postprocessing", "download"];

/// What is wrong with a file of rows.
#[derive(Debug, thiserror::Error)]
pub(super) enum Malformed {
    #[error("{0}")]
    Csv(#[from] csv::Error),
    #[error("no column of it is one of a run's, such as sensing, inference or total")]
    Foreign,
    #[error("line {line}, column {column}: {cell:?} is no {expected}")]
    Cell { line: u64, column: String, cell: String, expected: &'static str },
}

/// The columns of a file that is being read.
pub(super) struct Reading {
    columns: Vec<(Column, Option<Holds>)>,
    sums: bool,
}

impl Reading {
    /// All rows, and whether a column says which of them are warm-up.
    ///
    /// A last line that was cut off, as by a program that was ended while writing, is left out.
    pub(super) fn of(text: &[u8]) -> Result<(Vec<Row>, bool), Malformed> {
        let mut reader = csv::ReaderBuilder::new().from_reader(text);
        let holds = |name: &str| FIXED.iter().find(|(fixed, _)| *fixed == name).map(|(_, holds)| *holds);
        let names = reader.headers()?;
        let columns: Vec<_> =
            names.iter().map(|name| (columns::column(name.trim()), holds(name.trim()))).collect();
        let has = |wanted: &str| columns.iter().any(|(name, _)| name == wanted);
        if !columns.iter().any(|(_, holds)| matches!(holds, Some(Holds::Node))) {
            return Err(Malformed::Foreign);
        }
        let (flagged, ours, sums) = (has("warm-up"), has("outcome"), !has("stages-total"));
        let reading = Self { columns, sums };
        let cut_off = ours && !text.ends_with(b"\n");
        let mut rows = Vec::new();
        let mut records = reader.into_records().peekable();
        while let Some(record) = records.next() {
            if cut_off && records.peek().is_none() {
                break;
            }
            let number = rows.len() as u64 + 1;
            rows.push(reading.row(number, &record?)?);
        }
        Ok((rows, flagged))
    }

    fn row(&self, number: u64, record: &csv::StringRecord) -> Result<Row, Malformed> {
        let line = record.position().map_or(0, csv::Position::line);
        let mut row = Row {
            iteration: number,
            at: 0.0,
            episode: 0,
            step: 0,
            warm_up: false,
            outcome: Outcome::Ok,
            reason: None,
            values: Vec::with_capacity(self.columns.len()),
            upload: None,
            download: None,
        };
        let mut ways = [Way::default(), Way::default()];
        let mut unknown_stage = false;
        for ((name, holds), cell) in self.columns.iter().zip(record) {
            let (text, cell) = (cell, cell.trim());
            if cell.is_empty() {
                continue;
            }
            let wrong = |expected| Malformed::Cell {
                line,
                column: name.to_string(),
                cell: cell.to_owned(),
                expected,
            };
            let number = cell.parse::<f64>();
            match holds {
                Some(Holds::Place) if name == "outcome" => {
                    row.outcome = Outcome::from_name(cell).ok_or_else(|| wrong("outcome"))?;
                }
                Some(Holds::Place) if name == "reason" => row.reason = Some(text.to_owned()),
                Some(Holds::Place) => place(&mut row, name, number.map_err(|_| wrong("number"))?),
                Some(Holds::Delay) => {
                    let way = &mut ways[usize::from(name.starts_with("download"))];
                    way.take(name, cell).ok_or_else(|| wrong("delay, verdict or source"))?;
                }
                // A text that somebody put beside the numbers does no harm.
                None if number.is_err() => {}
                _ => {
                    let number = number.map_err(|_| wrong("number"))?;
                    if number.is_nan() {
                        unknown_stage |= PUBLISHED_STAGES.contains(&name.as_ref());
                    } else {
                        row.values.push((name.clone(), number));
                    }
                }
            }
        }
        let [up, down] = ways;
        row.upload = up.passage(&row, ["upload", "upload-bytes", "upload-logger-bytes"]);
        row.download = down.passage(&row, ["download", "download-bytes", "download-logger-bytes"]);
        if self.sums {
            let stages = || PUBLISHED_STAGES.iter().filter_map(|stage| row.value(stage));
            // What a stage took that is not known is missing in the sum as well.
            if stages().next().is_some() && !unknown_stage {
                let sum = stages().sum();
                row.values.push((columns::column("stages-total"), sum));
            }
        }
        Ok(row)
    }
}

fn place(row: &mut Row, name: &str, number: f64) {
    match name {
        "iteration" => row.iteration = number as u64,
        "at" => row.at = number,
        "episode" => row.episode = number as u32,
        "step" => row.step = number as u32,
        "warm-up" => row.warm_up = number != 0.0,
        _ => {}
    }
}

/// What is read of one direction's delay.
#[derive(Default)]
struct Way {
    raw: Option<Span>,
    lo: Option<Span>,
    hi: Option<Span>,
    verdict: Option<Verdict>,
    source: Option<DelaySource>,
}

impl Way {
    fn take(&mut self, column: &str, cell: &str) -> Option<()> {
        let span = || cell.parse().ok().map(Span::from_seconds_f64);
        match column.rsplit_once('-')?.1 {
            "raw" => self.raw = Some(span()?),
            "lo" => self.lo = Some(span()?),
            "hi" => self.hi = Some(span()?),
            "verdict" => self.verdict = Some(Verdict::from_name(cell)?),
            "source" => self.source = Some(DelaySource::from_name(cell)?),
            _ => return None,
        }
        Some(())
    }

    fn passage(self, row: &Row, [value, payload, metadata]: [&str; 3]) -> Option<Passage> {
        let bounds = self.lo.zip(self.hi).filter(|(lo, hi)| lo <= hi);
        let delay = OneWayDelay {
            raw: self.raw?,
            value: row.value(value).map(Span::from_seconds_f64),
            bounds: bounds.map(|(lo, hi)| Interval { lo, hi }),
            source: self.source?,
            verdict: self.verdict?,
        };
        Some(Passage {
            payload_bytes: row.value(payload)? as u64,
            logger_bytes: row.value(metadata)? as u64,
            delay,
        })
    }
}
