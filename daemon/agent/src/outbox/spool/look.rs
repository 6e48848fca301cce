//! What a file is before it is taken for a spool: nobody's notes or database must be written over or moved aside.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// In the header of every spool, so that it is told from other SQLite files: `PNsp`.
pub(super) const APPLICATION_ID: i32 = i32::from_be_bytes(*b"PNsp");

/// How every SQLite file begins (sqlite.org/fileformat2.html, 1.3).
const MAGIC: &[u8] = b"SQLite format 3\0";
/// Where the header has the application id, four bytes.
const ID_AT: usize = 68;
/// Where the first page has the number of its cells, two bytes: 0 where there is no table.
const CELLS_AT: usize = 103;
/// What is read of it.
const HEAD: usize = 105;

/// What a file is, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Look {
    /// A spool, or nothing yet: there is no file, an empty one, or a database without tables.
    Spool,
    /// The database of another program.
    Database,
    /// No SQLite file at all.
    Other,
}

impl Look {
    /// Looks at a file without SQLite, which would make files beside it. What a process that was killed left in the log
    /// alone is not seen: such a file has no tables.
    ///
    /// # Errors
    /// When it is there and cannot be read.
    pub(crate) fn at(path: &Path) -> io::Result<Self> {
        let mut head = Vec::with_capacity(HEAD);
        match File::open(path) {
            Ok(file) => file.take(HEAD as u64).read_to_end(&mut head)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => 0,
            Err(error) => return Err(error),
        };
        Ok(Self::of(&head))
    }

    fn of(head: &[u8]) -> Self {
        if !head.iter().zip(MAGIC).all(|(found, expected)| found == expected) {
            return Self::Other;
        }
        // Cut off within the header: it was one.
        let Some((id, cells)) = head.get(ID_AT..ID_AT + 4).zip(head.get(CELLS_AT..HEAD)) else {
            return Self::Spool;
        };
        if id == APPLICATION_ID.to_be_bytes() || (id == [0; 4] && cells == [0; 2]) {
            Self::Spool
        } else {
            Self::Database
        }
    }

    /// What is wrong with it and what to do, for a file that the user named.
    pub(crate) fn objection(self) -> Option<&'static str> {
        match self {
            Self::Spool => None,
            Self::Database => Some(
                "is the database of another program and not a spool; name another file with [spool] file",
            ),
            Self::Other => Some(
                "is not a spool; name another file with [spool] file, or, if it was one that its disk has spoilt, move \
                 it and the files with its name beside it away",
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bytes_tell_what_a_file_is() {
        let mut head = [0; HEAD];
        head[..MAGIC.len()].copy_from_slice(MAGIC);
        assert_eq!(Look::of(&head), Look::Spool, "without tables");
        head[CELLS_AT + 1] = 3;
        assert_eq!(Look::of(&head), Look::Database, "with tables");
        head[ID_AT..ID_AT + 4].copy_from_slice(b"PNsp");
        assert_eq!(Look::of(&head), Look::Spool);
        head[ID_AT] = b'X';
        assert_eq!(Look::of(&head), Look::Database, "another program's");
        for (text, expected) in [("", Look::Spool), ("SQLite for", Look::Spool), ("d3adb33f\n", Look::Other)]
        {
            assert_eq!(Look::of(text.as_bytes()), expected, "{text:?}");
        }
    }
}
