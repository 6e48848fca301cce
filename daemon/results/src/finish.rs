//! The files that are written at the end of a run, and a temporary folder for all files if the result folder cannot be
//! written.

use std::fs::{File, Permissions};
use std::io::{BufWriter, ErrorKind, IntoInnerError, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use peernet_analysis::WriteError;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::{FIXED_COLUMNS, RowRef, Rows};
use peernet_analysis::summary::Summary;
use peernet_logger::csv::ends_with_line;

use super::cells::Header;
use super::file_names::{DATA, RECORD, SUMMARIES};
use super::summary::{csv, latex, markdown};

/// Location of the written results.
#[derive(Debug)]
pub struct WrittenResults {
    /// Folder of the results: the requested folder, or a temporary folder if the requested folder cannot be written.
    pub folder: PathBuf,
    /// Paths of the written files.
    pub files: Vec<PathBuf>,
    /// Reason why the requested folder cannot be written; `None` if it was written.
    pub write_error: Option<WriteError>,
}

/// Permission bits of accounts that are neither the owner nor in the group.
const OTHER_ACCOUNTS: u32 = 0o007;

pub(crate) fn finish(folder: &Path, record: &RunRecord, rows: &Rows) -> Result<WrittenResults, WriteError> {
    let write_error = match write_files(folder, record, rows) {
        Ok(files) => return Ok(WrittenResults { folder: folder.to_owned(), files, write_error: None }),
        Err(write_error) => write_error,
    };
    let fallback = tempfile::Builder::new().prefix("peernet-results-").tempdir();
    let fallback = fallback
        .map_err(|error| combine_errors(&write_error, &std::env::temp_dir(), &error.to_string()))?
        // The folder must outlive the program, because it has the only complete results.
        .keep();
    match write_files(&fallback, record, rows) {
        Ok(files) => Ok(WrittenResults { folder: fallback, files, write_error: Some(write_error) }),
        Err(error) => {
            // Only an empty folder is removed. If all rows were written before the error, the folder stays.
            let _ = std::fs::remove_dir(&fallback);
            Err(combine_errors(&write_error, &error.path, &error.reason))
        }
    }
}

/// Joins the errors of the requested folder and of the temporary folder.
fn combine_errors(first: &WriteError, path: &Path, reason: &str) -> WriteError {
    let reason = format!("{}; also failed in {}: {reason}", first.reason, path.display());
    WriteError { path: first.path.clone(), reason }
}

fn write_files(folder: &Path, record: &RunRecord, rows: &Rows) -> Result<Vec<PathBuf>, WriteError> {
    // The record is written after the rows, so that a folder with a record has all rows of its run.
    let data = folder.join(DATA);
    if !is_complete(&data, rows) {
        replace(&data, rows)?;
    }
    let json = folder.join(RECORD);
    let text = serde_json::to_vec_pretty(record).map_err(WriteError::at(&json))?;
    write_private(&json, &text).map_err(WriteError::at(&json))?;
    let summary = Summary::from_run(record, rows);
    let mut files = vec![data, json];
    for (name, text) in SUMMARIES.into_iter().zip([markdown(&summary), csv(&summary), latex(&summary)]) {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(WriteError::at(&path))?;
        files.push(path);
    }
    Ok(files)
}

/// Returns whether the file has every row and the columns of all values. Rows that were written before a column was
/// added have empty cells in this column, even if they have a value for it. A file with such a row is not complete.
fn is_complete(path: &Path, rows: &Rows) -> bool {
    let Ok(mut file) = File::open(path) else { return false };
    if !ends_with_line(&mut file).unwrap_or(false) {
        return false;
    }
    let mut reader = csv::Reader::from_reader(file);
    let header = Header::for_rows(rows);
    let is_row = |record: &csv::ByteRecord, row: RowRef<'_>| {
        // Every file has the fixed columns from its beginning, so only values of the further columns can be missing.
        let further_columns = header.further_columns().iter().zip(record.iter().skip(FIXED_COLUMNS.len()));
        record.get(0) == Some(row.iteration().to_string().as_bytes())
            && further_columns.into_iter().all(|(name, cell)| cell.is_empty() == row.value(name).is_none())
    };
    let mut expected = rows.iter();
    reader.byte_headers().is_ok_and(|names| names.iter().eq(header.names().map(str::as_bytes)))
        && reader
            .byte_records()
            .all(|record| record.ok().zip(expected.next()).is_some_and(|(record, row)| is_row(&record, row)))
        && expected.next().is_none()
}

/// Writes the rows to a new file and renames it to `path`, so that the file at `path` is always
/// complete.
fn replace(path: &Path, rows: &Rows) -> Result<(), WriteError> {
    let new_file = path.with_extension("csv.new");
    let result = write_rows(&new_file, rows).and_then(|()| std::fs::rename(&new_file, path));
    result.map_err(WriteError::at(path)).inspect_err(|_| {
        // The new file does not exist if it could not be created.
        let _ = std::fs::remove_file(&new_file);
    })
}

fn write_rows(path: &Path, rows: &Rows) -> std::io::Result<()> {
    let header = Header::for_rows(rows);
    let mut out = BufWriter::new(File::create(path)?);
    let mut bytes = Vec::new();
    header.write_header(&mut bytes);
    for row in rows.iter().map(RowRef::to_row) {
        header.write_row(&mut bytes, &row);
        out.write_all(&bytes)?;
        bytes.clear();
    }
    out.write_all(&bytes)?;
    // The caller renames the file; after a power failure, an unsynced file could be empty.
    out.into_inner().map_err(IntoInnerError::into_error)?.sync_all()
}

/// Writes a file that only its owner and its group can read, because arguments of programs may contain secrets.
fn write_private(path: &Path, content: &[u8]) -> std::io::Result<()> {
    let mut file = File::options().create(true).truncate(true).write(true).mode(0o640).open(path)?;
    // An existing file keeps its mode when it is opened, so the mode is changed afterwards. A pipe or
    // a device at `path` is not a file of this run and keeps its mode. File systems without
    // permissions, such as FAT, refuse to change the mode, which is no error.
    let metadata = file.metadata()?;
    let mode = metadata.permissions().mode();
    if metadata.is_file()
        && mode & OTHER_ACCOUNTS != 0
        && let Err(error) = file.set_permissions(Permissions::from_mode(mode & !OTHER_ACCOUNTS))
        && error.kind() != ErrorKind::PermissionDenied
    {
        return Err(error);
    }
    let result = file.write_all(content);
    if !metadata.is_file() {
        return result;
    }
    // Without the record the rows can still be read, but not with a part of the record. A file can be truncated on a full
    // disk, too. After a power failure, an unsynced file could be incomplete.
    result.and_then(|()| file.sync_all()).inspect_err(|_| _ = file.set_len(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_file_becomes_private() {
        let folder = tempfile::tempdir().expect("a folder");
        let (file, pipe) = (folder.path().join("run.json"), folder.path().join("pipe"));
        std::fs::write(&file, "earlier").expect("writable");
        let status = std::process::Command::new("mkfifo").arg(&pipe).status().expect("coreutils");
        assert!(status.success(), "{status}");
        let mode = |path: &Path| path.metadata().expect("it is there").permissions().mode() & 0o777;
        for path in [&file, &pipe] {
            std::fs::set_permissions(path, Permissions::from_mode(0o666)).expect("the owner may do so");
        }
        write_private(&file, b"{}").expect("writable");
        assert_eq!(mode(&file), 0o660);
        // Opening a pipe for writing waits for a reader.
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || std::fs::read(pipe)
        });
        write_private(&pipe, b"{}").expect("writable");
        assert_eq!(reader.join().expect("no panic").expect("readable"), b"{}");
        assert_eq!(mode(&pipe), 0o666);
    }
}
