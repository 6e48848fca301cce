//! The pages in a database's write-ahead log (`-wal`), read without SQLite.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::pages::be32;

/// Size of the write-ahead log's header.
pub(crate) const HEADER_BYTES: usize = 32;
/// Size of the header of a frame, which holds one page.
pub(crate) const FRAME_BYTES: usize = 24;
/// First four bytes of a write-ahead log, without the lowest bit, which gives the byte order of the checksums.
pub(crate) const MAGIC: u32 = 0x377f_0682;

/// The newest version of each page that is in the write-ahead log.
///
/// A checkpoint copies pages from the log into the main file one after the other. The checkpoint leaves out pages whose
/// older version a reader still needs. Therefore the main file alone may mix versions of different
/// times.
///
/// The checksums and the commit marks of the log's frames are not examined. Therefore this value
/// may contain pages that are not completely written, and pages of a transaction that is not
/// committed.
#[derive(Debug)]
pub(super) struct LogPages {
    file: File,
    page_bytes: usize,
    /// Offset of the newest version of each page in the log file.
    offsets: HashMap<u32, u64>,
}

/// Returns the path of the write-ahead log of a database. A symbolic link to the database is resolved, because the log
/// lies beside the database itself.
pub(crate) fn log_path(database: &Path) -> PathBuf {
    let mut path = std::fs::canonicalize(database).unwrap_or_else(|_| database.to_owned()).into_os_string();
    path.push("-wal");
    path.into()
}

impl LogPages {
    /// Reads which pages are in the write-ahead log. Returns `None` if there is no log, or the log has no valid header.
    ///
    /// # Errors
    /// When the log cannot be read. This applies to all functions here that return an `io::Result`.
    pub(super) fn open(log: &Path, page_bytes: usize) -> io::Result<Option<Self>> {
        let file = match File::open(log) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            opened => opened?,
        };
        let mut header = [0; HEADER_BYTES];
        if !read_whole(&file, &mut header, 0)?
            || be32(&header, 0) & !1 != MAGIC
            || be32(&header, 8) as usize != page_bytes
        {
            return Ok(None);
        }
        let mut offsets = HashMap::new();
        let mut offset = HEADER_BYTES as u64;
        let mut frame = [0; FRAME_BYTES];
        // Frames of an earlier use of the write-ahead log have other salts. Their pages are in the main file already.
        while read_whole(&file, &mut frame, offset)? && frame[8..16] == header[16..24] {
            offsets.insert(be32(&frame, 0), offset + FRAME_BYTES as u64);
            offset += (FRAME_BYTES + page_bytes) as u64;
        }
        Ok(Some(Self { file, page_bytes, offsets }))
    }

    /// Returns the numbers of the pages in the write-ahead log.
    pub(super) fn numbers(&self) -> impl Iterator<Item = u32> {
        self.offsets.keys().copied()
    }

    /// Returns whether a page is in the write-ahead log.
    pub(super) fn contains(&self, number: u32) -> bool {
        self.offsets.contains_key(&number)
    }

    /// Reads one page; `None` if the page is not in the write-ahead log.
    pub(super) fn read(&self, number: u32) -> io::Result<Option<Vec<u8>>> {
        let Some(offset) = self.offsets.get(&number) else { return Ok(None) };
        let mut bytes = vec![0; self.page_bytes];
        Ok(read_whole(&self.file, &mut bytes, *offset)?.then_some(bytes))
    }
}

/// Fills the buffer from the file. Returns `false` if the file ends before the buffer is full.
pub(crate) fn read_whole(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<bool> {
    match file.read_exact_at(buffer, offset) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(false),
        read => read.map(|()| true),
    }
}
