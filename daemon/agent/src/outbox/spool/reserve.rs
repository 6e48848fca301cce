//! Room on the disk that is kept for deleting.
//!
//! SQLite writes before it deletes: into the log, and from there into the file. A spool that filled its disk could
//! never be emptied, nor say how much did not fit. So a file beside it holds some room, which is given free for a deletion
//! or such a count, and taken again after it. It stays when the process ends: on a full disk the next one needs it.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

/// What the log may hold when the disk becomes full (256 pages and the largest transaction), and what deleting adds.
const BYTES: u64 = 6 << 20;
/// On a disk that has less, it is taken in such steps.
const STEP: u64 = 128 << 10;
/// Unit of the blocks that the system counts (POSIX leaves it open; Linux's is this one).
const BLOCK: u64 = 512;

/// The room.
#[derive(Debug)]
pub(super) struct Reserve {
    file: PathBuf,
    /// Bytes that it holds; below [`BYTES`] nothing but deletions and counts may be written before there is more.
    held: u64,
    /// The file system cannot hold room.
    impossible: bool,
}

impl Reserve {
    /// Goes on with what an earlier process held.
    pub(super) fn new(file: PathBuf) -> Self {
        let held = fs::metadata(&file).map_or(0, |held| BYTES.min(held.blocks() * BLOCK));
        Self { file, held, impossible: false }
    }

    /// Gives the room free; returns whether there was any.
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

    /// Takes the room, or what there is of it; returns whether it is whole, if it can be held at all.
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
