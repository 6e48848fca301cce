//! Rows of a `data.csv`, read one after the other in a bounded amount of memory.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use csv::StringRecord;
use peernet_logger::csv::{column_name, ends_with_line};

/// Maximum length of the header and of a row, bytes. A row that PEERNet writes has a few thousand bytes.
const MAX_ROW_BYTES: usize = 64 << 10;

/// Opens a regular file.
///
/// # Errors
/// If it is not a regular file or cannot be opened.
pub(super) fn open_regular_file(file: &Path) -> io::Result<File> {
    // The type is checked before the file is opened: opening a named pipe waits for a writer, and reading a device may
    // never end.
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("it is not a regular file; name the data.csv of a run"));
    }
    File::open(file)
}

/// Rows of a file, without the header and without an unfinished last line.
pub(super) struct LatencyRows {
    reader: csv::Reader<BoundedReader>,
    header: StringRecord,
    /// Next row; `None` at the end.
    // One row is read ahead, because only the end of the file shows which row is the last one.
    next: Option<StringRecord>,
    /// Whether the last line is unfinished.
    is_truncated: bool,
}

impl LatencyRows {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// Returns the reason if the file is not regular or cannot be read.
    pub(super) fn open(file: &Path) -> Result<Self, String> {
        let mut opened = open_regular_file(file).map_err(|error| error.to_string())?;
        let ends_with_line = ends_with_line(&mut opened).map_err(|error| error.to_string())?;
        let bounded = BoundedReader { file: opened, remaining: MAX_ROW_BYTES };
        // `flexible` switches off the reader's check of the number of cells, because an unfinished last row may have
        // too few. `next_row` skips such a row and checks all others.
        let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(bounded);
        let header = reader.headers().map_err(|error| format!("its header: {error}"))?;
        let header: StringRecord = header.iter().map(column_name).collect();
        // Only PEERNet writes the column `outcome`. Other programs may leave out the line feed after a complete last
        // line.
        let is_truncated = !ends_with_line && header.iter().any(|name| name == "outcome");
        let mut rows = Self { reader, header, next: None, is_truncated };
        rows.next = rows.read()?;
        Ok(rows)
    }

    /// Returns the names of the columns.
    pub(super) const fn header(&self) -> &StringRecord {
        &self.header
    }

    /// Returns the next row with its line number; `None` at the end.
    ///
    /// # Errors
    /// Returns the reason if the row cannot be read, is too long, or has another number of cells than the header.
    pub(super) fn next_row(&mut self) -> Result<Option<(u64, StringRecord)>, String> {
        let Some(row) = self.next.take() else { return Ok(None) };
        let following = self.read();
        // The program that writes an unfinished line still runs, or was killed.
        if matches!(following, Ok(None)) && self.is_truncated {
            return Ok(None);
        }
        let line = row.position().map_or(0, csv::Position::line);
        if row.len() != self.header.len() {
            return Err(format!("line {line} has {} cells instead of {}", row.len(), self.header.len()));
        }
        self.next = following?;
        Ok(Some((line, row)))
    }

    fn read(&mut self) -> Result<Option<StringRecord>, String> {
        let line = self.reader.position().line();
        // The reader's buffer may already contain the beginning of this row, so a row may exceed the limit by the size
        // of this buffer.
        self.reader.get_mut().remaining = MAX_ROW_BYTES;
        let mut row = StringRecord::new();
        match self.reader.read_record(&mut row) {
            Ok(true) => Ok(Some(row)),
            Ok(false) => Ok(None),
            Err(error) if error.is_io_error() => Err(format!("line {line}: {error}")),
            Err(error) => Err(error.to_string()),
        }
    }
}

/// Reader that fails when the permitted number of bytes has been read.
// Without this limit, a file without line feeds, or with a quotation mark that is never closed, would be one row as
// large as the file.
struct BoundedReader {
    file: File,
    /// Number of bytes until the failure.
    remaining: usize,
}

impl Read for BoundedReader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.remaining == 0 {
            let limit = MAX_ROW_BYTES >> 10;
            return Err(io::Error::other(format!(
                "it is longer than {limit} KiB, so the file is no data.csv"
            )));
        }
        let count = self.file.read(buffer)?;
        self.remaining = self.remaining.saturating_sub(count);
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::*;

    #[test]
    fn special_and_sparse_files_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let refusal = |file: &Path| LatencyRows::open(file).err().expect("is refused");
        let pipe = folder.path().join("pipe");
        mknodat(CWD, &pipe, FileType::Fifo, Mode::RUSR, 0).expect("a pipe");
        for special in [&*pipe, Path::new("/dev/zero"), folder.path()] {
            assert_eq!(refusal(special), "it is not a regular file; name the data.csv of a run");
        }
        let sparse = folder.path().join("sparse");
        File::create(&sparse).and_then(|file| file.set_len(1 << 40)).expect("written");
        assert_eq!(refusal(&sparse), "its header: it is longer than 64 KiB, so the file is no data.csv");
    }
}
