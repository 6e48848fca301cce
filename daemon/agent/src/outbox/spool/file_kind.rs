//! Determines the kind of a file before it is used as a spool, because other files must not be overwritten or moved.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Application id in the header of every spool, `PNsp`, which distinguishes spools from other SQLite files.
pub(super) const APPLICATION_ID: i32 = i32::from_be_bytes(*b"PNsp");

/// First bytes of every SQLite file (sqlite.org/fileformat2.html, 1.3).
const MAGIC: &[u8] = b"SQLite format 3\0";
/// Offset of the application id in the header, four bytes.
const ID_OFFSET: usize = 68;
/// Offset of the number of cells in the first page, two bytes; 0 means that the database has no table.
const CELLS_OFFSET: usize = 103;
/// Number of bytes that are read from the start of a file.
const HEADER_BYTES: usize = 105;

/// Kind of a file, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileKind {
    /// A spool, or a path at which a spool can be created: no file, an empty file, or a database without tables.
    Spool,
    /// A database of another program.
    Database,
    /// Not an SQLite file.
    Other,
}

impl FileKind {
    /// Reads the kind of a file without SQLite, which would create further files. Tables that are only in the
    /// write-ahead log of a killed process are not found: such a file seems to have no tables.
    ///
    /// # Errors
    /// When the file exists and cannot be read.
    pub(crate) fn from_path(path: &Path) -> io::Result<Self> {
        let mut header = Vec::with_capacity(HEADER_BYTES);
        match File::open(path) {
            Ok(file) => file.take(HEADER_BYTES as u64).read_to_end(&mut header)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => 0,
            Err(error) => return Err(error),
        };
        Ok(Self::from_header(&header))
    }

    fn from_header(header: &[u8]) -> Self {
        if !header.iter().zip(MAGIC).all(|(actual, expected)| actual == expected) {
            return Self::Other;
        }
        // A file with a truncated header may be a damaged spool. Opening it as a spool shows the damage.
        let Some((id, cells)) =
            header.get(ID_OFFSET..ID_OFFSET + 4).zip(header.get(CELLS_OFFSET..HEADER_BYTES))
        else {
            return Self::Spool;
        };
        if id == APPLICATION_ID.to_be_bytes() || (id == [0; 4] && cells == [0; 2]) {
            Self::Spool
        } else {
            Self::Database
        }
    }

    /// Returns why a file that the user configured cannot be used, and what to do; `None` if it can be used.
    pub(crate) fn refusal_reason(self) -> Option<&'static str> {
        match self {
            Self::Spool => None,
            Self::Database => Some(
                "is the database of another program and not a spool; name another file with [spool] file",
            ),
            Self::Other => Some(
                "is not a spool; name another file with [spool] file, or, if it is a damaged spool, move it away together with \
                 the files that have its name as a prefix",
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_bytes_identify_file_kind() {
        let mut header = [0; HEADER_BYTES];
        header[..MAGIC.len()].copy_from_slice(MAGIC);
        assert_eq!(FileKind::from_header(&header), FileKind::Spool, "without tables");
        header[CELLS_OFFSET + 1] = 3;
        assert_eq!(FileKind::from_header(&header), FileKind::Database, "with tables");
        header[ID_OFFSET..ID_OFFSET + 4].copy_from_slice(b"PNsp");
        assert_eq!(FileKind::from_header(&header), FileKind::Spool);
        header[ID_OFFSET] = b'X';
        assert_eq!(
            FileKind::from_header(&header),
            FileKind::Database,
            "the application id of another program"
        );
        for (text, expected) in
            [("", FileKind::Spool), ("SQLite for", FileKind::Spool), ("d3adb33f\n", FileKind::Other)]
        {
            assert_eq!(FileKind::from_header(text.as_bytes()), expected, "{text:?}");
        }
    }
}
