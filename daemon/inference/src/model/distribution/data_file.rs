//! Latencies of a recorded run, from columns of its `data.csv`.

use std::path::Path;

use csv::StringRecord;
use peernet_logger::csv::{PUBLISHED_WARM_UP_ROWS, is_warm_up};
use peernet_logger::stage;

use super::columns::Columns;
use super::latency::MAX_LATENCY_S;
use super::latency_rows::LatencyRows;
use crate::LoadError;

/// Maximum number of latencies (80 MB).
const MAX_LATENCIES: usize = 10_000_000;
/// Maximum number of columns that an error names.
const MAX_NAMED_COLUMNS: usize = 60;
/// Maximum length of the text of a cell in an error, characters.
const MAX_SHOWN_CHARS: usize = 40;

/// A stage that is not part of the latencies is reported if its mean is at least this fraction of the mean latency.
const MIN_REPORTED_SHARE: f64 = 0.01;

/// Latencies of a recorded run.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RecordedLatencies {
    /// Latencies, seconds; at least one.
    pub(super) latencies: Vec<f64>,
    /// Stages of the model that are not part of the latencies, each with its mean in seconds. Stages whose mean is
    /// below 1 % of the mean latency are not listed.
    pub(super) omitted_stages: Vec<(String, f64)>,
}

/// Reads the latencies in a `data.csv`. A latency is the sum of the cells that a row has in `columns`; if one of these
/// cells is empty, the row has no latency. Only iterations that are in the statistics count: they have an answer and
/// are not warm-up. The program that was published with the paper writes files without columns for outcome and warm-up.
/// All iterations of such a file count except the first [`PUBLISHED_WARM_UP_ROWS`].
///
/// # Errors
/// If the file is not a regular file or cannot be read; if a column is missing or occurs twice; if a row is too long;
/// if one of its cells in `columns` is neither empty nor a latency; if a cell that marks the warm-up is no truth value;
/// or if no row has a latency.
pub(super) fn read_latencies(file: &Path, columns: &Columns) -> Result<RecordedLatencies, LoadError> {
    let file_error = |reason: String| LoadError::File { file: file.to_owned(), reason };
    let mut rows = LatencyRows::open(file).map_err(file_error)?;
    let header = rows.header().clone();
    let position_of = |name: &str| column_position(&header, name);
    let positions = columns.names().iter().map(|column| {
        position_of(column)?.ok_or_else(|| {
            let known: Vec<&str> = header.iter().take(MAX_NAMED_COLUMNS).collect();
            format!("it has no column {column}; it has {}", known.join(", "))
        })
    });
    let value_positions = positions.collect::<Result<Vec<usize>, String>>().map_err(file_error)?;
    let (outcome_position, warm_up_position) =
        (position_of("outcome").map_err(file_error)?, position_of("warm-up").map_err(file_error)?);
    let mut omitted = omitted_stages(columns, position_of).map_err(file_error)?;
    let mut latencies = Vec::new();
    for index in 0.. {
        let Some((line, record)) = rows.next_row().map_err(file_error)? else { break };
        let cell = |position: Option<usize>| position.and_then(|position| record.get(position));
        let is_warm_up = match cell(warm_up_position) {
            Some(cell) => is_warm_up(cell).ok_or_else(|| {
                file_error(format!("line {line}, column warm-up: {cell:?} is not a number"))
            })?,
            None => index < PUBLISHED_WARM_UP_ROWS,
        };
        if is_warm_up || cell(outcome_position).is_some_and(|outcome| !["", "ok"].contains(&outcome.trim())) {
            continue;
        }
        let sum = sum_of_cells(&record, &value_positions)
            .map_err(|reason| file_error(format!("line {line}: {reason}")))?;
        let Some(latency) = sum else { continue };
        latencies.push(latency);
        // No latency is drawn from the columns of omitted stages, so a defect in their cells is ignored.
        omitted.iter_mut().for_each(|stage| {
            stage.sum_s += latency_in_cell(&record, stage.position).ok().flatten().unwrap_or_default();
        });
        if latencies.len() > MAX_LATENCIES {
            return Err(file_error(format!(
                "it has more than {MAX_LATENCIES} latencies; give a shorter file"
            )));
        }
    }
    if latencies.is_empty() {
        let warm_up =
            format!("the warm-up (without the column warm-up: the first {PUBLISHED_WARM_UP_ROWS} rows)");
        let reason = match columns.names() {
            [column] => format!("its column {column} has no number in a row with an answer after {warm_up}"),
            _ => format!(
                "its columns {columns} do not all have a number in any row with an answer after {warm_up}"
            ),
        };
        return Err(file_error(reason));
    }
    let min_sum_s = latencies.iter().sum::<f64>() * MIN_REPORTED_SHARE;
    let count = latencies.len() as f64;
    // `min_sum_s` is 0 if all latencies are 0. A stage that took no time is not reported even then.
    omitted.retain(|stage| stage.sum_s > 0.0 && stage.sum_s >= min_sum_s);
    let omitted_stages = omitted.into_iter().map(|stage| (stage.column, stage.sum_s / count)).collect();
    Ok(RecordedLatencies { latencies, omitted_stages })
}

/// A stage of the model that has a column in the file, but is not part of the latencies.
struct OmittedStage {
    column: String,
    position: usize,
    sum_s: f64,
}

/// Returns the stages of the model that have a column in the file, but are not among `columns`. Returns none if
/// `inference` is not among `columns`: another column, such as `total`, may contain all stages.
fn omitted_stages(
    columns: &Columns,
    position_of: impl Fn(&str) -> Result<Option<usize>, String>,
) -> Result<Vec<OmittedStage>, String> {
    if !columns.contains(stage::INFERENCE.as_str()) {
        return Ok(Vec::new());
    }
    let stages = [stage::PREPROCESSING, stage::POSTPROCESSING].map(|stage| stage.to_string());
    let omitted = stages.into_iter().filter(|stage| !columns.contains(stage));
    let with_positions = omitted.map(|column| {
        Ok(position_of(&column)?.map(|position| OmittedStage { column, position, sum_s: 0.0 }))
    });
    with_positions.filter_map(Result::transpose).collect()
}

/// Returns the position of a column; `None` if no column has that name.
///
/// # Errors
/// Returns the reason if several columns have the name.
fn column_position(header: &StringRecord, name: &str) -> Result<Option<usize>, String> {
    let mut positions =
        header.iter().enumerate().filter(|(_, cell)| *cell == name).map(|(position, _)| position);
    match (positions.next(), positions.next()) {
        (first, None) => Ok(first),
        (_, Some(_)) => Err(format!("it has several columns {name}; rename or remove all but one")),
    }
}

/// Returns the sum of the latencies in the cells at `positions`, seconds; `None` if one of the cells is empty.
fn sum_of_cells(record: &StringRecord, positions: &[usize]) -> Result<Option<f64>, String> {
    let values =
        positions.iter().map(|position| latency_in_cell(record, *position)).collect::<Result<Vec<_>, _>>()?;
    let Some(sum) = values.into_iter().sum::<Option<f64>>() else { return Ok(None) };
    if sum > MAX_LATENCY_S {
        return Err(format!(
            "the sum of the columns, {sum}, is above {MAX_LATENCY_S} seconds; name other columns"
        ));
    }
    Ok(Some(sum))
}

/// Returns the latency in a cell, seconds; `None` if the cell is empty.
fn latency_in_cell(record: &StringRecord, position: usize) -> Result<Option<f64>, String> {
    let cell = record.get(position).unwrap_or_default().trim();
    if cell.is_empty() {
        return Ok(None);
    }
    let shortened = || cell.chars().take(MAX_SHOWN_CHARS).collect::<String>();
    let number: f64 = cell.parse().map_err(|_| format!("{:?} is not a number", shortened()))?;
    if (0.0..=MAX_LATENCY_S).contains(&number) {
        Ok(Some(number))
    } else {
        Err(format!(
            "{} is not a latency in seconds, from 0 to {MAX_LATENCY_S}; correct or empty the cell, or name another column",
            shortened()
        ))
    }
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
        let file = data_file(folder.path()).expect("the folder of a run");
        read_latencies(&file, &columns).map_err(|error| error.to_string())
    }

    fn read(text: &str, column: &str) -> Result<Vec<f64>, String> {
        recorded(text, &[column]).map(|recorded| recorded.latencies)
    }

    #[test]
    fn only_answered_iterations_after_warm_up_count() {
        let text = "iteration,inference,total,warm-up,outcome\n\
                    1,9.0,9.1,1,ok\n2,0.01,0.02,0,ok\n3,0.5,,0,failed\n4,,0.3,0,ok\n5,,0.4,0,ok\n6,0.03,0.04,0,ok\n";
        assert_eq!(read(text, "inference"), Ok(vec![0.01, 0.03]));
        assert_eq!(read(text, "total"), Ok(vec![0.02, 0.3, 0.4, 0.04]));
    }

    #[test]
    fn unfinished_line_is_left_out() {
        let text = "iteration,inference,warm-up,outcome\n1,0.5,0,ok\n2,0.25,0,ok\n";
        for unfinished_line in ["3,0.7,0,ok", "3,0.7", "3"] {
            assert_eq!(read(&format!("{text}{unfinished_line}"), "inference"), Ok(vec![0.5, 0.25]));
        }
    }

    #[test]
    fn same_rows_count_as_in_results() {
        // A file of the paper's program: the first five rows are the warm-up, and its last line may lack the line feed.
        let published =
            "iteration, inference_val ,inference_head\n1,9,9\n2,9,9\n3,9,9\n4,9,9\n5,9,9\n6,0.5,9\n7,0.25,9";
        assert_eq!(read(published, "inference"), Ok(vec![0.5, 0.25]));
        let export_of_dashboard =
            "iteration,warm-up,outcome,total\n1,true,ok,9\n2,false,ok,0.5\n3,false,lost,\n";
        assert_eq!(read(export_of_dashboard, "total"), Ok(vec![0.5]));
        let error = read(&export_of_dashboard.replace("true", "maybe"), "total").expect_err("no truth value");
        assert!(error.contains("line 2, column warm-up: \"maybe\" is not a number"), "{error}");
    }

    #[test]
    fn file_without_latencies_is_refused_with_reason() {
        for (text, reason) in [
            ("iteration,total\n1,0.5\n", "it has no column inference; it has iteration, total"),
            (
                "inference,warm-up\n,0\n0.1,1\n",
                "its column inference has no number in a row with an answer after the warm-up",
            ),
            (
                "iteration,inference\n1,0.1\n",
                "after the warm-up (without the column warm-up: the first 5 rows)",
            ),
            ("inference,a,inference\n0.1,0,0.2\n", "it has several columns inference"),
            ("inference,outcome,outcome\n0.1,ok,ok\n", "it has several columns outcome"),
            ("inference,warm-up\nnan,0\n", "line 2: nan is not a latency in seconds"),
            ("inference,warm-up\n0.1,0\ninf,0\n", "line 3: inf is not a latency in seconds"),
            ("inference,warm-up\n1e300,0\n", "line 2: 1e300 is not a latency in seconds"),
            ("inference,warm-up\n-0.1,0\n", "line 2: -0.1 is not a latency in seconds"),
            ("inference,warm-up\n0.1,0\n1000000,0\n", "line 3: 1000000 is not a latency"),
            ("inference,warm-up\nfast,0\n", "line 2: \"fast\" is not a number"),
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
    fn latency_is_sum_of_columns() {
        let text = "preprocessing,inference,postprocessing,warm-up,outcome\n\
                    0.25,0.5,0.125,0,ok\n9.0,9.0,9.0,1,ok\n,0.5,0.125,0,ok\n0.5,1.0,0.25,0,ok\n";
        let whole = recorded(text, &["preprocessing", "inference", "postprocessing"]).expect("three columns");
        assert_eq!(whole, RecordedLatencies { latencies: vec![0.875, 1.75], omitted_stages: Vec::new() });
        let empty = recorded("preprocessing,inference\n,0.5\n0.5,\n", &["preprocessing", "inference"]);
        let reason = "its columns preprocessing + inference do not all have a number in any row";
        assert!(empty.expect_err("no sum").contains(reason));
        let too_long =
            recorded("inference,postprocessing,warm-up\n50000,50000,0\n", &["inference", "postprocessing"]);
        assert!(too_long.expect_err("too long").contains("line 2: the sum of the columns, 100000"));
    }

    #[test]
    fn too_long_rows_are_refused() {
        let long = "x".repeat(100_000);
        for (text, reason) in [
            (format!("inference,{long}\n0.1,0\n"), "it is longer than 64 KiB"),
            (format!("inference\n0.1\n{long}\n"), "line 3: it is longer than 64 KiB"),
            (format!("inference\n\"{}", "0.1\n".repeat(30_000)), "line 2: it is longer than 64 KiB"),
        ] {
            let error = read(&text, "inference").expect_err("too long");
            assert!(error.contains(reason), "{error}");
        }
        assert_eq!(
            read(&format!("inference,warm-up,a\n0.1,0,{}\n", "x".repeat(60_000)), "inference"),
            Ok(vec![0.1])
        );
    }

    #[test]
    fn omitted_stage_below_one_percent_is_not_reported() {
        let text = |preprocessing: f64, postprocessing: f64| {
            format!(
                "preprocessing,inference,postprocessing,total,warm-up\n{preprocessing},1.0,{postprocessing},3.0,0\n"
            )
        };
        let omitted = |text: &str, columns: &[&str]| {
            recorded(text, columns).map(|recorded| recorded.omitted_stages).expect("latencies")
        };
        let named = |column: &str, mean_s: f64| (column.to_owned(), mean_s);
        assert_eq!(omitted(&text(0.01, 0.009), &["inference"]), [named("preprocessing", 0.01)]);
        assert_eq!(omitted(&text(0.5, 0.5), &["preprocessing", "inference"]), [named("postprocessing", 0.5)]);
        assert_eq!(omitted(&text(0.5, 0.5), &["total"]), [], "a total contains all stages");
        assert_eq!(omitted("inference,warm-up\n0.0,0\n", &["inference"]), []);
    }
}
