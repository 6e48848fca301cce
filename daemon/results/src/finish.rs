//! The last files of a run, and another place for all of them when the folder fails.

use std::fs::{File, Permissions};
use std::io::{BufWriter, ErrorKind, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use peernet_analysis::WriteError;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::{FIXED_COLUMNS, RowRef, Rows};
use peernet_analysis::summary::Summary;

use super::cells::Header;
use super::file_names::{DATA, RECORD, SUMMARIES};
use super::parse::ends_with_line;
use super::summary::{csv, latex, markdown};

/// Where the results are.
#[derive(Debug)]
pub struct Finished {
    /// The folder: the one that was asked for, or a temporary one when that could not be written.
    pub folder: PathBuf,
    /// The files in it.
    pub files: Vec<PathBuf>,
    /// Why the folder that was asked for could not be written.
    pub trouble: Option<WriteError>,
}

/// The permission bits of everybody who is neither the owner nor in the group.
const OTHERS: u32 = 0o007;

pub(crate) fn finish(folder: &Path, record: &RunRecord, rows: &Rows) -> Result<Finished, WriteError> {
    let trouble = match all(folder, record, rows) {
        Ok(files) => return Ok(Finished { folder: folder.to_owned(), files, trouble: None }),
        Err(trouble) => trouble,
    };
    let elsewhere = tempfile::Builder::new().prefix("peernet-results-").tempdir();
    let elsewhere =
        elsewhere.map_err(|error| also(&trouble, &std::env::temp_dir(), &error.to_string()))?.keep();
    match all(&elsewhere, record, rows) {
        Ok(files) => Ok(Finished { folder: elsewhere, files, trouble: Some(trouble) }),
        Err(error) => {
            // Nothing of use is there unless all rows are: then it stays.
            let _ = std::fs::remove_dir(&elsewhere);
            Err(also(&trouble, &error.path, &error.reason))
        }
    }
}

/// Neither place could be written.
fn also(first: &WriteError, path: &Path, reason: &str) -> WriteError {
    let reason = format!("{}; nor {}: {reason}", first.reason, path.display());
    WriteError { path: first.path.clone(), reason }
}

fn all(folder: &Path, record: &RunRecord, rows: &Rows) -> Result<Vec<PathBuf>, WriteError> {
    let data = folder.join(DATA);
    if !is_whole(&data, rows) {
        replace(&data, rows)?;
    }
    let json = folder.join(RECORD);
    let text = serde_json::to_vec_pretty(record).map_err(WriteError::at(&json))?;
    write_private(&json, &text).map_err(WriteError::at(&json))?;
    let summary = Summary::of(rows).about(record);
    let mut files = vec![data, json];
    for (name, text) in SUMMARIES.into_iter().zip([markdown(&summary), csv(&summary), latex(&summary)]) {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(WriteError::at(&path))?;
        files.push(path);
    }
    Ok(files)
}

/// Whether the file has every row, and a cell for everything in it: a column that came late is missing in the rows that
/// were written before the file got it.
fn is_whole(path: &Path, rows: &Rows) -> bool {
    let Ok(mut file) = File::open(path) else { return false };
    if !ends_with_line(&mut file).unwrap_or(false) {
        return false;
    }
    let mut reader = csv::Reader::from_reader(file);
    let header = Header::of(rows);
    let is_row = |record: &csv::ByteRecord, row: RowRef<'_>| {
        let further = header.further().iter().zip(record.iter().skip(FIXED_COLUMNS.len()));
        record.get(0) == Some(row.iteration().to_string().as_bytes())
            && further.into_iter().all(|(name, cell)| cell.is_empty() == row.value(name).is_none())
    };
    let mut expected = rows.iter();
    reader.byte_headers().is_ok_and(|names| names.iter().eq(header.names().map(str::as_bytes)))
        && reader
            .byte_records()
            .all(|record| record.ok().zip(expected.next()).is_some_and(|(record, row)| is_row(&record, row)))
        && expected.next().is_none()
}

/// Writes the file beside the old one first, so that there is always one that is whole.
fn replace(path: &Path, rows: &Rows) -> Result<(), WriteError> {
    let beside = path.with_extension("csv.new");
    let written = put(&beside, rows).and_then(|()| std::fs::rename(&beside, path));
    written.map_err(WriteError::at(path)).inspect_err(|_| {
        // It is not there when it could not even be made.
        let _ = std::fs::remove_file(&beside);
    })
}

fn put(path: &Path, rows: &Rows) -> std::io::Result<()> {
    let header = Header::of(rows);
    let mut out = BufWriter::new(File::create(path)?);
    let mut bytes = Vec::new();
    header.write(&mut bytes);
    for row in rows.iter().map(RowRef::to_row) {
        header.row(&mut bytes, &row);
        out.write_all(&bytes)?;
        bytes.clear();
    }
    out.write_all(&bytes)?;
    out.flush()
}

/// Writes a file that others may not read: the arguments of programs may hold secrets.
fn write_private(path: &Path, content: &[u8]) -> std::io::Result<()> {
    let mut file = File::options().create(true).truncate(true).write(true).mode(0o640).open(path)?;
    // One that was there before kept its mode. A file system without permissions, such as FAT, has none to set.
    let mode = file.metadata()?.permissions().mode();
    if mode & OTHERS != 0
        && let Err(error) = file.set_permissions(Permissions::from_mode(mode & !OTHERS))
        && error.kind() != ErrorKind::PermissionDenied
    {
        return Err(error);
    }
    file.write_all(content)
}
