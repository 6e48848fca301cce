//! Reading of results.

use std::path::{Path, PathBuf};

use peernet_analysis::accuracy::Accuracy;
use peernet_analysis::actuator_results::ActuatorResults;
use peernet_analysis::deadline::Misses;
use peernet_analysis::loaded::{Loaded, NO_RECORD};
use peernet_analysis::record::{Clocks, Counts, RunRecord};
use peernet_analysis::rows::Rows;
use peernet_logger::csv::PUBLISHED_WARM_UP_ROWS;

use super::FolderError;
use super::file_names::{DATA, RECORD};
use super::parse::RowParser;

/// Reads results, with the columns that `wanted` accepts.
pub(crate) fn open(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Loaded, FolderError> {
    let (folder, data) = if path.is_file() {
        (path.parent().unwrap_or(Path::new("")).to_owned(), path.to_owned())
    } else {
        (path.to_owned(), path.join(DATA))
    };
    if !data.is_file() {
        return Err(FolderError::NoResults(folder));
    }
    // The record belongs to `data.csv` only, not to other files in the folder.
    let record = if data.ends_with(DATA) { read_record(&folder.join(RECORD))? } else { None };
    // A program that writes a record also writes warm-up flags.
    let warm_up = if record.is_none() { PUBLISHED_WARM_UP_ROWS } else { 0 };
    let (rows, has_warm_up_flags) =
        RowParser::read_rows(&data, warm_up, wanted).map_err(read_error(&data))?;
    let record = record.unwrap_or_else(|| {
        // Only this program writes a `data.csv` with warm-up flags. (CSV exports of dashboards have
        // such flags, too, but other file names.) Without `run.json`, the run has not ended or was
        // killed.
        let reason = if has_warm_up_flags && data.ends_with(DATA) { NO_RECORD } else { "" };
        RunRecord { reason: reason.into(), ..record_without_file(path, &rows, has_warm_up_flags) }
    });
    Ok(Loaded { folder, record, rows })
}

/// Reads the record; `None` if the file does not exist or is empty. The file is empty if the disk was full when the run
/// ended.
fn read_record(path: &Path) -> Result<Option<RunRecord>, FolderError> {
    let read = || match path.metadata()? {
        metadata if metadata.is_file() => std::fs::read(path),
        _ => Err(std::io::Error::other("it is not a regular file")),
    };
    match read() {
        Ok(text) if text.is_empty() => Ok(None),
        Ok(text) => Ok(Some(serde_json::from_slice(&text).map_err(read_error(path))?)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(read_error(path)(error)),
    }
}

/// Returns a record for rows without a record file, with the facts that follow from the path and the rows.
fn record_without_file(path: &Path, rows: &Rows, has_warm_up_flags: bool) -> RunRecord {
    // A path such as `.` contains no name.
    let name = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = if path.is_file() { name.file_stem() } else { name.file_name() };
    let name = name.unwrap_or_default().to_string_lossy().into_owned();
    let warm_up = if has_warm_up_flags {
        String::new()
    } else {
        format!("the first {PUBLISHED_WARM_UP_ROWS} rows, which the figures of the paper's program leave out")
    };
    RunRecord {
        title: name.clone(),
        name,
        warm_up,
        counts: Counts::from_rows(rows, 0),
        clocks: Clocks::from_rows(rows),
        misses: Misses::from_rows(rows),
        actuator: ActuatorResults::from_rows(rows),
        accuracy: Accuracy::by_column(rows),
        ..RunRecord::default()
    }
}

fn read_error<E: std::fmt::Display>(path: &Path) -> impl Fn(E) -> FolderError {
    let path = PathBuf::from(path);
    move |error| FolderError::Read { path: path.clone(), reason: error.to_string() }
}
