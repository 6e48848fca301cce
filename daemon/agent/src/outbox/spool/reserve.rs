//! Disk space that is reserved for deleting.
//!
//! SQLite writes before it deletes: first to the log, then to the file. A spool that filled its disk could neither be
//! emptied nor record how many events did not fit. So a file beside it occupies some space, which is released for a
//! deletion or such a record and allocated again afterwards. The file stays when the process ends, because on a full
//! disk the next process could not allocate it.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

/// Size of the reserve in bytes: the log when the disk becomes full (256 pages and the largest transaction), and what
/// deleting adds.
const BYTES: u64 = 6 << 20;
/// Step in which the reserve is allocated on a disk with less room, in bytes.
const STEP: u64 = 128 << 10;
/// Unit of `st_blocks` in bytes (undefined in POSIX; 512 in Linux).
const BLOCK: u64 = 512;

/// The reserved space.
#[derive(Debug)]
pub(super) struct Reserve {
    file: PathBuf,
    /// Bytes that are allocated. Below [`BYTES`] nothing but deletions and totals may be written.
    held: u64,
    /// `true` if the file system cannot allocate space.
    impossible: bool,
}

impl Reserve {
    /// Takes over the reserve of an earlier process.
    pub(super) fn new(file: PathBuf) -> Self {
        let held = fs::metadata(&file).map_or(0, |held| BYTES.min(held.blocks() * BLOCK));
        Self { file, held, impossible: false }
    }

    /// Releases the space. Returns whether there was any.
    pub(super) fn release(&mut self) -> bool {
        if self.held == 0 {
            return false;
        }
        match fs::remove_file(&self.file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::debug!(%error, "the spool's reserve {} cannot be given free", self.file.display());
                false
            }
            _ => {
                self.held = 0;
                true
            }
        }
    }

    /// Allocates the space, or as much as there is. Returns whether the reserve is complete, or cannot exist on this
    /// file system.
    pub(super) fn take(&mut self) -> bool {
        if self.impossible || self.held == BYTES {
            return true;
        }
        match self.allocate() {
            Ok(()) => {}
            Err(Errno::OPNOTSUPP) => self.impossible = true,
            Err(error) => {
                tracing::debug!(%error, held = self.held, "the disk lacks room for the spool's reserve {}", self.file.display());
            }
        }
        if self.held == 0
            && let Err(error) = fs::remove_file(&self.file)
        {
            tracing::debug!(%error, "no reserve to remove");
        }
        self.impossible || self.held == BYTES
    }

    fn allocate(&mut self) -> Result<(), Errno> {
        let file = File::options().create(true).truncate(false).write(true).open(&self.file);
        let file = file.map_err(|error| Errno::from_io_error(&error).unwrap_or(Errno::IO))?;
        let none = FallocateFlags::empty();
        if fallocate(&file, none, 0, BYTES).is_err() {
            while self.held < BYTES {
                let step = STEP.min(BYTES - self.held);
                fallocate(&file, none, self.held, step)?;
                self.held += step;
            }
        }
        self.held = BYTES;
        Ok(())
    }
}
