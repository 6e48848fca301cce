//! Writer of `data.csv` during a run.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use peernet_analysis::WriteError;
use peernet_analysis::rows::Row;

use super::cells::{self, Header};

/// Rows are written as soon as the starts of their iterations span this time, seconds.
const WRITE_INTERVAL_S: f64 = 1.0;
/// Number of waiting bytes at which rows are written even before [`WRITE_INTERVAL_S`] is over.
const MAX_PENDING_BYTES: usize = 256 * 1024;

/// Writer of `data.csv` during a run. While rows come, they are written at least once a second, and the rest at the end.
///
/// No measurement is lost if the disk is full or missing. Rows that cannot be written stay in memory and are written
/// with the next rows. The file always ends with a complete row.
#[derive(Debug)]
pub struct RowWriter {
    path: PathBuf,
    file: File,
    header: Header,
    /// Length of the complete rows in the file, bytes.
    complete_bytes: u64,
    /// Rows that are not in the file yet. Each row has as many cells as the header.
    pending: Vec<u8>,
    /// Number of rows so far, written or pending.
    row_count: u64,
    /// Number of rows at the last attempt to rewrite the file.
    row_count_at_rewrite: u64,
    /// Start of the iteration whose row caused the last attempt to write, seconds.
    written_at: f64,
    /// Length of `pending` after the last attempt to write.
    pending_after_attempt: usize,
    /// True if the file may have a part of a row after the complete rows.
    has_partial_row: bool,
    /// Error of the last attempt to write; `None` if the attempt succeeded.
    write_error: Option<WriteError>,
}

impl RowWriter {
    /// Creates the file with its header.
    pub(crate) fn create(path: PathBuf) -> Result<Self, WriteError> {
        let header = Header::default();
        let file = File::create(&path).map_err(WriteError::at(&path))?;
        let mut pending = Vec::new();
        header.write_header(&mut pending);
        let mut writer = Self {
            path,
            file,
            header,
            complete_bytes: 0,
            pending,
            row_count: 0,
            row_count_at_rewrite: 0,
            written_at: 0.0,
            pending_after_attempt: 0,
            has_partial_row: false,
            write_error: None,
        };
        writer.write_pending().map_err(WriteError::at(&writer.path))?;
        Ok(writer)
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Adds a row.
    ///
    /// A row may have columns that no earlier row had. The file is then rewritten with these columns, but only if its
    /// number of rows has at least doubled since the last rewriting, so that rewriting takes no more time in all than
    /// writing. Values without a column are left out until [`ResultFolder::finish`](super::ResultFolder::finish) adds them.
    pub fn write(&mut self, row: &Row) {
        if self.row_count >= 2 * self.row_count_at_rewrite && !self.header.covers(row) {
            self.add_columns(row);
        }
        self.header.write_row(&mut self.pending, row);
        self.row_count += 1;
        // Bytes that the last attempt could not write do not count. On a full disk, each row would otherwise cause an
        // attempt.
        let has_many_bytes = self.pending.len() >= self.pending_after_attempt + MAX_PENDING_BYTES;
        // The absolute difference is used, because a clock that was set back must not stop the writing.
        if has_many_bytes || (row.at - self.written_at).abs() >= WRITE_INTERVAL_S {
            self.flush();
            self.written_at = row.at;
        }
    }

    /// Writes the pending rows. The caller calls this function while no rows come.
    pub fn flush(&mut self) {
        self.write_error = self.write_pending().map_err(WriteError::at(&self.path)).err();
        self.pending_after_attempt = self.pending.len();
    }

    /// Returns the reason why rows are still pending; `None` if they were written.
    pub fn write_error(&self) -> Option<&WriteError> {
        self.write_error.as_ref()
    }

    /// Writes the pending rows and syncs the file.
    ///
    /// # Errors
    /// If rows cannot be written. The file then ends with the last row that was written;
    /// [`ResultFolder::finish`](super::ResultFolder::finish) writes all rows to another folder if necessary.
    pub fn finish(mut self) -> Result<PathBuf, WriteError> {
        let result = self.write_pending().and_then(|()| self.file.sync_all());
        result.map_err(WriteError::at(&self.path))?;
        Ok(self.path)
    }

    fn write_pending(&mut self) -> std::io::Result<()> {
        self.truncate_partial_row()?;
        let (written, outcome) = write_counted(&mut self.file, &self.pending);
        let complete_bytes = complete_rows_len(&self.pending[..written]);
        self.complete_bytes += complete_bytes as u64;
        self.pending.drain(..complete_bytes);
        if outcome.is_err() {
            self.has_partial_row = true;
            // The first error is reported. Truncating is tried again before the next write.
            let _ = self.truncate_partial_row();
        }
        outcome
    }

    /// Removes the part of a row that a failed write may have left. A file can be truncated on a full disk, too.
    fn truncate_partial_row(&mut self) -> std::io::Result<()> {
        if self.has_partial_row {
            self.file.set_len(self.complete_bytes)?;
            self.file.seek(SeekFrom::Start(self.complete_bytes))?;
            self.has_partial_row = false;
        }
        Ok(())
    }

    /// Rewrites the file with the further columns of a row. If this fails, the file and the header stay as they are, and
    /// the next attempt follows after the number of rows has doubled.
    fn add_columns(&mut self, row: &Row) {
        self.row_count_at_rewrite = self.row_count;
        self.flush();
        if self.write_error.is_some() {
            return;
        }
        let mut header = self.header.clone();
        header.add(row);
        match self.rewrite(&header) {
            Ok((file, complete_bytes)) => {
                (self.file, self.complete_bytes, self.header) = (file, complete_bytes, header);
            }
            Err(error) => self.write_error = Some(WriteError::at(&self.path)(error)),
        }
    }

    fn rewrite(&self, header: &Header) -> std::io::Result<(File, u64)> {
        let new_file = self.path.with_extension("csv.new");
        let result = cells::pad_rows(&self.path, &new_file, header).and_then(|()| {
            // The new file is opened before it is renamed. If opening failed after the renaming,
            // rows would still be written to `self.file`, which then has no name, and be lost.
            let mut file = OpenOptions::new().write(true).open(&new_file)?;
            let complete_bytes = file.seek(SeekFrom::End(0))?;
            std::fs::rename(&new_file, &self.path)?;
            Ok((file, complete_bytes))
        });
        result.inspect_err(|_| {
            // The new file does not exist if it could not be created.
            let _ = std::fs::remove_file(&new_file);
        })
    }
}

/// Writes all bytes. In contrast to `write_all`, it returns the number of written bytes even after an error.
fn write_counted(out: &mut impl Write, bytes: &[u8]) -> (usize, std::io::Result<()>) {
    let mut written = 0;
    while written < bytes.len() {
        match out.write(&bytes[written..]) {
            Ok(0) => return (written, Err(ErrorKind::WriteZero.into())),
            Ok(count) => written += count,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return (written, Err(error)),
        }
    }
    (written, Ok(()))
}

/// Returns the length of the complete rows at the beginning of `bytes`. A line feed within quotes does not end a row.
fn complete_rows_len(bytes: &[u8]) -> usize {
    let (mut is_quoted, mut complete_len) = (false, 0);
    for (index, byte) in bytes.iter().enumerate() {
        match byte {
            b'"' => is_quoted = !is_quoted,
            b'\n' if !is_quoted => complete_len = index + 1,
            _ => {}
        }
    }
    complete_len
}

#[cfg(test)]
mod tests {
    use super::*;
    use peernet_analysis::rows::Outcome;

    fn row(iteration: u64) -> Row {
        Row {
            iteration,
            at: iteration as f64,
            episode: 0,
            step: 0,
            warm_up: false,
            outcome: Outcome::Ok,
            reason: None,
            values: vec![("total".into(), 0.25)],
            upload: None,
            download: None,
        }
    }

    #[test]
    fn rows_are_written_when_full_disk_has_space_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut writer = RowWriter::create(folder.path().join("data.csv")).expect("writable");
        writer.write(&row(1));
        let disk = std::mem::replace(
            &mut writer.file,
            OpenOptions::new().write(true).open("/dev/full").expect("Linux has this device"),
        );
        writer.write(&row(2));
        let write_error = writer.write_error().expect("the disk is full").to_string();
        assert!(write_error.contains("data.csv: No space left on device"), "{write_error}");
        writer.write(&row(3));
        writer.file = disk;
        writer.write(&row(4));
        assert!(writer.write_error().is_none());
        let path = writer.finish().expect("writable again");
        let text = std::fs::read_to_string(path).expect("text");
        let numbers: Vec<_> = text.lines().skip(1).filter_map(|line| line.split(',').next()).collect();
        assert_eq!(numbers, ["1", "2", "3", "4"]);
    }

    #[test]
    fn only_complete_rows_count_as_written_to_full_disk() {
        let rows = b"1,ok\n2,\"a \"\"b\"\"\nc\"\n3,ok\n";
        let (first_row, first_two_rows) = (5, rows.len() - 5);
        for (free_bytes, complete_bytes) in [
            // Without the line feed of the first row.
            (first_row - 1, 0),
            (first_row, first_row),
            // Up to a quote within the quoted cell of the second row.
            (14, first_row),
            // Up to the end of the quoted cell, which contains a line feed.
            (first_two_rows - 1, first_row),
            // Without the line feed of the last row.
            (rows.len() - 1, first_two_rows),
            (rows.len(), rows.len()),
        ] {
            let mut disk = vec![0; free_bytes];
            let (written, outcome) = write_counted(&mut disk.as_mut_slice(), rows);
            assert_eq!((written, outcome.is_ok()), (free_bytes, free_bytes == rows.len()));
            assert_eq!(complete_rows_len(&rows[..written]), complete_bytes, "{free_bytes} free bytes");
        }
    }

    #[test]
    fn permanently_full_disk_is_reported_at_end() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut writer = RowWriter::create(folder.path().join("data.csv")).expect("writable");
        writer.file = OpenOptions::new().write(true).open("/dev/full").expect("Linux has this device");
        writer.write(&row(1));
        let error = writer.finish().expect_err("the disk is full").to_string();
        assert!(error.contains("data.csv"), "{error}");
    }
}
