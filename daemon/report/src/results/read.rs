//! Results read back.

use std::path::{Path, PathBuf};

use super::folder::{DATA, RECORD};
use super::parse::Reading;
use super::{Clocks, Counts, FolderError, HostRecord, Loaded, Row, RunRecord};

/// Rows at the beginning that the published figures leave out.
const PUBLISHED_WARM_UP: usize = 5;

pub(super) fn open(path: &Path) -> Result<Loaded, FolderError> {
    let (folder, data) = if path.is_file() {
        (path.parent().unwrap_or(Path::new("")).to_owned(), path.to_owned())
    } else {
        (path.to_owned(), path.join(DATA))
    };
    if !data.is_file() {
        return Err(FolderError::NoResults(folder));
    }
    let (mut rows, flagged) = rows(&data)?;
    let json = folder.join(RECORD);
    let record = match std::fs::read(&json) {
        Ok(text) => serde_json::from_slice(&text).map_err(failed(&json))?,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            if !flagged {
                rows.iter_mut().take(PUBLISHED_WARM_UP).for_each(|row| row.warm_up = true);
            }
            alone(path, &rows, flagged)
        }
        Err(error) => return Err(failed(&json)(error)),
    };
    Ok(Loaded { folder, record, rows })
}

/// What can be said of rows that nothing stands beside.
fn alone(path: &Path, rows: &[Row], flagged: bool) -> RunRecord {
    let name = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = if path.is_file() { name.file_stem() } else { name.file_name() };
    let name = name.unwrap_or_default().to_string_lossy().into_owned();
    let warm_up = if flagged {
        String::new()
    } else {
        format!("the first {PUBLISHED_WARM_UP} rows, as the published figures leave them out")
    };
    RunRecord {
        title: name.clone(),
        name,
        edge: HostRecord::default(),
        warm_up,
        counts: Counts::of(rows, 0),
        clocks: Clocks::of(rows),
        ..RunRecord::default()
    }
}

/// The rows, and whether they say themselves which are warm-up.
fn rows(path: &Path) -> Result<(Vec<Row>, bool), FolderError> {
    let text = std::fs::read(path).map_err(failed(path))?;
    Reading::of(&text).map_err(failed(path))
}

fn failed<E: std::fmt::Display>(path: &Path) -> impl Fn(E) -> FolderError {
    let path = PathBuf::from(path);
    move |error| FolderError::Read { path: path.clone(), reason: error.to_string() }
}
