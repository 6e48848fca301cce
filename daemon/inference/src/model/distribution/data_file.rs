//! Latencies of a recorded run, from a column of its `data.csv`.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use csv::StringRecord;

use super::latency::MAX_LATENCY_S;
use crate::LoadError;

/// Name of the file in a folder of results.
const FILE_NAME: &str = "data.csv";
/// Largest number of latencies (80 MB).
const MAX_LATENCIES: usize = 10_000_000;
/// Numbers beyond it count as unknown everywhere in PEERNet.
const MAX_NUMBER: f64 = 1e140;

/// Returns the file that a path names: the file itself, or `data.csv` in a folder.
pub(super) fn data_file(path: &Path) -> PathBuf {
    if path.is_dir() { path.join(FILE_NAME) } else { path.to_owned() }
}

/// Reads the latencies in a column of a `data.csv`, seconds, from the iterations that statistics include: iterations with
/// an answer that are not warm-up. A file without columns for outcome and warm-up has only such iterations; for example, a
/// file of the program that was published with the paper.
///
/// # Errors
/// If the file cannot be read, has no such column, or the column has no latency.
pub(super) fn read_latencies(file: &Path, column: &str) -> Result<Vec<f64>, LoadError> {
    let wrong = |reason: String| LoadError::File { file: file.to_owned(), reason };
    let mut opened = File::open(file).map_err(|error| wrong(error.to_string()))?;
    let is_complete = ends_with_line_feed(&mut opened).map_err(|error| wrong(error.to_string()))?;
    // A row with another number of cells is an error only if a running program did not leave it behind.
    let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(BufReader::new(opened));
    let header = reader.headers().map_err(|error| wrong(error.to_string()))?.clone();
    let position = |name: &str| header.iter().position(|cell| cell == name);
    let Some(value_at) = position(column) else {
        let known: Vec<&str> = header.iter().take(60).collect();
        return Err(wrong(format!("it has no column {column}; it has {}", known.join(", "))));
    };
    let (outcome_at, warm_up_at) = (position("outcome"), position("warm-up"));
    let mut latencies = Vec::new();
    let mut records = reader.records().peekable();
    while let Some(record) = records.next() {
        // A last line without a line feed was written by a program that was killed meanwhile.
        if records.peek().is_none() && !is_complete {
            break;
        }
        let record = record.map_err(|error| wrong(error.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        if record.len() != header.len() {
            return Err(wrong(format!("line {line} has {} cells instead of {}", record.len(), header.len())));
        }
        let cell = |at: Option<usize>| at.and_then(|at| record.get(at));
        let is_counted = cell(outcome_at).is_none_or(|outcome| outcome == "ok")
            && cell(warm_up_at).is_none_or(|warm_up| warm_up == "0");
        if !is_counted {
            continue;
        }
        latencies
            .extend(latency(&record, value_at).map_err(|reason| wrong(format!("line {line}: {reason}")))?);
        if latencies.len() > MAX_LATENCIES {
            return Err(wrong(format!("it has more than {MAX_LATENCIES} latencies; give a shorter file")));
        }
    }
    if latencies.is_empty() {
        return Err(wrong(format!("its column {column} has no number in a row with an answer")));
    }
    Ok(latencies)
}

/// Returns the latency in a cell, seconds; `None` if it is unknown.
fn latency(record: &StringRecord, at: usize) -> Result<Option<f64>, String> {
    let cell = record.get(at).unwrap_or_default();
    if cell.is_empty() {
        return Ok(None);
    }
    let number: f64 = cell.parse().map_err(|_| format!("{cell:?} is not a number"))?;
    // This is as in `peernet compare`: such a cell is unknown.
    if !number.is_finite() || number.abs() > MAX_NUMBER {
        return Ok(None);
    }
    if (0.0..=MAX_LATENCY_S).contains(&number) {
        Ok(Some(number))
    } else {
        Err(format!("{cell} is not a latency in seconds, from 0 to {MAX_LATENCY_S}; name another column"))
    }
}

fn ends_with_line_feed(file: &mut File) -> std::io::Result<bool> {
    if file.seek(SeekFrom::End(0))? == 0 {
        return Ok(true);
    }
    let mut last = [0];
    file.seek(SeekFrom::End(-1))?;
    file.read_exact(&mut last)?;
    file.rewind()?;
    Ok(last == *b"\n")
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn read(text: &str, column: &str) -> Result<Vec<f64>, String> {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join(FILE_NAME), text).expect("written");
        read_latencies(&data_file(folder.path()), column).map_err(|error| error.to_string())
    }

    #[test]
    fn only_answered_iterations_after_warm_up_count() {
        let text = "iteration,inference,total,warm-up,outcome\n\
                    1,9.0,9.1,1,ok\n2,0.01,0.02,0,ok\n3,0.5,,0,failed\n4,,0.3,0,ok\n5,nan,0.4,0,ok\n6,0.03,0.04,0,ok\n";
        assert_eq!(read(text, "inference"), Ok(vec![0.01, 0.03]));
        assert_eq!(read(text, "total"), Ok(vec![0.02, 0.3, 0.4, 0.04]));
    }

    #[test]
    fn published_file_and_unfinished_line_are_read() {
        assert_eq!(read("iteration,inference\n1,0.5\n2,0.25\n3,0.7", "inference"), Ok(vec![0.5, 0.25]));
        assert_eq!(read("iteration,inference\n1,0.5\n2", "inference"), Ok(vec![0.5]));
    }

    #[test]
    fn file_without_latencies_is_refused_with_reason() {
        for (text, reason) in [
            ("iteration,total\n1,0.5\n", "it has no column inference; it has iteration, total"),
            ("iteration,inference\n1,\n", "its column inference has no number"),
            ("iteration,inference\n1,-0.1\n", "line 2: -0.1 is not a latency in seconds"),
            ("iteration,inference\n1,0.1\n2,1000000\n", "line 3: 1000000 is not a latency"),
            ("iteration,inference\n1,fast\n", "line 2: \"fast\" is not a number"),
            ("iteration,inference\n1,0.1,3\n", "line 2 has 3 cells instead of 2"),
            ("", "it has no column inference"),
        ] {
            let error = read(text, "inference").expect_err(reason);
            assert!(error.contains(reason) && error.contains("data.csv"), "{error}");
        }
        let missing = read_latencies(Path::new("/nowhere/data.csv"), "inference").expect_err("is missing");
        assert!(missing.is_missing(), "{missing}");
    }
}
