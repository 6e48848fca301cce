//! Latencies of a recorded run, from columns of its `data.csv`.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use csv::StringRecord;
use peernet_logger::stage;

use super::columns::Columns;
use super::latency::MAX_LATENCY_S;
use crate::LoadError;

/// Largest number of latencies (80 MB).
const MAX_LATENCIES: usize = 10_000_000;
/// Numbers beyond it count as unknown everywhere in PEERNet.
const MAX_NUMBER: f64 = 1e140;

/// Smallest share of the mean latency at which a stage that is not part of the latencies is reported.
const MIN_REPORTED_SHARE: f64 = 0.01;

/// Latencies of a recorded run.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RecordedLatencies {
    /// Latencies, seconds; at least one.
    pub(super) latencies: Vec<f64>,
    /// Stages of the model that the latencies do not contain, with their means in seconds, if they are 1 % of the mean latency or
    /// more.
    pub(super) omitted_stages: Vec<(String, f64)>,
}

/// Reads the latencies in a `data.csv`, each the sum of the columns in a row, from the iterations that statistics include:
/// iterations with an answer that are not warm-up. A file without columns for outcome and warm-up has only such iterations; for
/// example, a file of the program that was published with the paper. A row in which a column is empty has no latency.
///
/// # Errors
/// If the file cannot be read, lacks a column, or no row has a latency.
pub(super) fn read_latencies(file: &Path, columns: &Columns) -> Result<RecordedLatencies, LoadError> {
    let wrong = |reason: String| LoadError::File { file: file.to_owned(), reason };
    let mut opened = File::open(file).map_err(|error| wrong(error.to_string()))?;
    let is_complete = ends_with_line_feed(&mut opened).map_err(|error| wrong(error.to_string()))?;
    // A row with another number of cells is an error only if a running program did not leave it behind.
    let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(BufReader::new(opened));
    let header = reader.headers().map_err(|error| wrong(error.to_string()))?.clone();
    let position = |name: &str| header.iter().position(|cell| cell == name);
    let named = columns.names().iter().map(|column| {
        position(column).ok_or_else(|| {
            let known: Vec<&str> = header.iter().take(60).collect();
            wrong(format!("it has no column {column}; it has {}", known.join(", ")))
        })
    });
    let value_positions = named.collect::<Result<Vec<usize>, LoadError>>()?;
    let (outcome_at, warm_up_at) = (position("outcome"), position("warm-up"));
    let mut omitted: Vec<OmittedStage> = omitted_stages(columns, position);
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
        let sum = sum_of_cells(&record, &value_positions)
            .map_err(|reason| wrong(format!("line {line}: {reason}")))?;
        let Some(latency) = sum else { continue };
        latencies.push(latency);
        // The column is not drawn from, so that a defect in it is no error.
        omitted.iter_mut().for_each(|stage| {
            stage.sum_s += latency_in_cell(&record, stage.at).ok().flatten().unwrap_or_default();
        });
        if latencies.len() > MAX_LATENCIES {
            return Err(wrong(format!("it has more than {MAX_LATENCIES} latencies; give a shorter file")));
        }
    }
    if latencies.is_empty() {
        let reason = match columns.names() {
            [column] => format!("its column {column} has no number in a row with an answer"),
            _ => format!("no row with an answer has a number in each of the columns {columns}"),
        };
        return Err(wrong(reason));
    }
    let least_s = latencies.iter().sum::<f64>() * MIN_REPORTED_SHARE;
    let count = latencies.len() as f64;
    omitted.retain(|stage| stage.sum_s > 0.0 && stage.sum_s >= least_s);
    let omitted_stages = omitted.into_iter().map(|stage| (stage.column, stage.sum_s / count)).collect();
    Ok(RecordedLatencies { latencies, omitted_stages })
}

/// A stage of the model that is in the file and not in the latencies.
struct OmittedStage {
    column: String,
    at: usize,
    sum_s: f64,
}

/// Returns the other stages of a model whose `inference` is drawn. Other columns, such as `total`, may contain them.
fn omitted_stages(columns: &Columns, position: impl Fn(&str) -> Option<usize>) -> Vec<OmittedStage> {
    if !columns.contains(stage::INFERENCE.as_str()) {
        return Vec::new();
    }
    let stages = [stage::PREPROCESSING, stage::POSTPROCESSING].map(|stage| stage.to_string());
    let omitted = stages.into_iter().filter(|stage| !columns.contains(stage));
    omitted.filter_map(|column| position(&column).map(|at| OmittedStage { column, at, sum_s: 0.0 })).collect()
}

/// Returns the sum of the latencies in some cells, seconds; `None` if one is unknown.
fn sum_of_cells(record: &StringRecord, positions: &[usize]) -> Result<Option<f64>, String> {
    let values = positions.iter().map(|at| latency_in_cell(record, *at)).collect::<Result<Vec<_>, _>>()?;
    let Some(sum) = values.into_iter().sum::<Option<f64>>() else { return Ok(None) };
    if sum > MAX_LATENCY_S {
        return Err(format!(
            "the sum of the columns, {sum}, is above {MAX_LATENCY_S} seconds; name other columns"
        ));
    }
    Ok(Some(sum))
}

/// Returns the latency in a cell, seconds; `None` if it is unknown.
fn latency_in_cell(record: &StringRecord, at: usize) -> Result<Option<f64>, String> {
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

    use super::super::run_folder::{FILE_NAME, data_file};
    use super::*;

    fn recorded(text: &str, columns: &[&str]) -> Result<RecordedLatencies, String> {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join(FILE_NAME), text).expect("written");
        let columns = serde_json::from_value(serde_json::json!(columns)).expect("columns");
        let file = data_file(folder.path()).expect("no experiment");
        read_latencies(&file, &columns).map_err(|error| error.to_string())
    }

    fn read(text: &str, column: &str) -> Result<Vec<f64>, String> {
        recorded(text, &[column]).map(|recorded| recorded.latencies)
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
        let missing = read_latencies(Path::new("/nowhere/data.csv"), &Columns::default());
        let missing = missing.expect_err("is missing");
        assert!(missing.is_missing(), "{missing}");
    }

    #[test]
    fn columns_of_a_row_are_added() {
        let text = "preprocessing,inference,postprocessing,warm-up,outcome\n\
                    0.25,0.5,0.125,0,ok\n9.0,9.0,9.0,1,ok\n,0.5,0.125,0,ok\n0.5,1.0,0.25,0,ok\n";
        let whole = recorded(text, &["preprocessing", "inference", "postprocessing"]).expect("three columns");
        assert_eq!(whole, RecordedLatencies { latencies: vec![0.875, 1.75], omitted_stages: Vec::new() });
        let empty = recorded("preprocessing,inference\n,0.5\n0.5,\n", &["preprocessing", "inference"]);
        let reason = "no row with an answer has a number in each of the columns preprocessing + inference";
        assert!(empty.expect_err("no sum").contains(reason));
        let too_long = recorded("inference,download\n50000,50000\n", &["inference", "download"]);
        assert!(too_long.expect_err("too long").contains("line 2: the sum of the columns, 100000"));
    }

    #[test]
    fn omitted_stages_are_those_of_one_percent() {
        let text = |preprocessing: f64, postprocessing: f64| {
            format!(
                "preprocessing,inference,postprocessing,total\n{preprocessing},1.0,{postprocessing},3.0\n"
            )
        };
        let omitted = |text: &str, columns: &[&str]| {
            recorded(text, columns).map(|recorded| recorded.omitted_stages).expect("latencies")
        };
        let named = |column: &str, mean_s: f64| (column.to_owned(), mean_s);
        assert_eq!(omitted(&text(0.01, 0.009), &["inference"]), [named("preprocessing", 0.01)]);
        assert_eq!(omitted(&text(0.5, 0.5), &["preprocessing", "inference"]), [named("postprocessing", 0.5)]);
        assert_eq!(omitted(&text(0.5, 0.5), &["total"]), [], "a total contains all stages");
        assert_eq!(omitted("inference\n0.0\n", &["inference"]), []);
    }
}
