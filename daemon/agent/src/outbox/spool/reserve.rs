//! Disk space that is reserved for deleting.
//!
//! To delete rows, SQLite writes first to the write-ahead log and then to the file. A spool that filled its disk could
//! neither be emptied nor record how many events did not fit. Therefore a file next to the spool occupies some space.
//! This space is released for a deletion or such a record, and allocated again afterwards. The file remains when the
//! process ends, because on a full disk the next process could not allocate it.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

/// Size of the reserve in bytes: the largest write-ahead log (256 pages and the largest transaction), and the pages
/// that a deletion adds to this log.
const RESERVE_BYTES: u64 = 6 << 20;
/// Step in bytes by which the reserve grows on a disk that has less free space than [`RESERVE_BYTES`].
const ALLOCATION_STEP_BYTES: u64 = 128 << 10;
/// Unit of `st_blocks` in bytes (undefined in POSIX; 512 in Linux).
const BLOCK_BYTES: u64 = 512;

/// The reserved space.
#[derive(Debug)]
pub(super) struct Reserve {
    file: PathBuf,
    /// Number of allocated bytes. While it is below [`RESERVE_BYTES`], only deletions and totals may be written.
    allocated: u64,
    /// `true` if the file system cannot allocate space.
    is_unsupported: bool,
}

impl Reserve {
    /// Creates the reserve from the file of an earlier process, if it exists.
    pub(super) fn new(file: PathBuf) -> Self {
        let allocated =
            fs::metadata(&file).map_or(0, |metadata| RESERVE_BYTES.min(metadata.blocks() * BLOCK_BYTES));
        Self { file, allocated, is_unsupported: false }
    }

    /// Releases the space by removing the file. Returns whether any space was released.
    pub(super) fn release(&mut self) -> bool {
        if self.allocated == 0 {
            return false;
        }
        match fs::remove_file(&self.file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::debug!(%error, "cannot release the spool's reserve {}", self.file.display());
                false
            }
            _ => {
                self.allocated = 0;
                true
            }
        }
    }

    /// Allocates the space, or as much as is free. Returns `true` if the reserve is complete, or if the file system
    /// does not support the allocation of space.
    pub(super) fn allocate(&mut self) -> bool {
        if self.is_unsupported || self.allocated == RESERVE_BYTES {
            return true;
        }
        match self.try_allocate() {
            Ok(()) => {}
            Err(Errno::OPNOTSUPP) => self.is_unsupported = true,
            Err(error) => {
                tracing::debug!(%error, allocated = self.allocated, "cannot allocate all of the spool's reserve {}", self.file.display());
            }
        }
        if self.allocated == 0
            && let Err(error) = fs::remove_file(&self.file)
        {
            tracing::debug!(%error, "no reserve to remove");
        }
        self.is_unsupported || self.allocated == RESERVE_BYTES
    }

    fn try_allocate(&mut self) -> Result<(), Errno> {
        let file = File::options().create(true).truncate(false).write(true).open(&self.file);
        let file = file.map_err(|error| Errno::from_io_error(&error).unwrap_or(Errno::IO))?;
        let no_flags = FallocateFlags::empty();
        if fallocate(&file, no_flags, 0, RESERVE_BYTES).is_err() {
            while self.allocated < RESERVE_BYTES {
                let step = ALLOCATION_STEP_BYTES.min(RESERVE_BYTES - self.allocated);
                fallocate(&file, no_flags, self.allocated, step)?;
                self.allocated += step;
            }
        }
        self.allocated = RESERVE_BYTES;
        Ok(())
    }
}
