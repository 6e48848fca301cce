//! Locks on files.

use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;

/// An exclusive lock on a file, released when this is dropped or the process ends in any way.
///
/// The file is not removed. Otherwise two processes could lock two different files of the same name.
#[derive(Debug)]
pub(crate) struct FileLock {
    _file: File,
}

impl FileLock {
    /// Creates the file if it is missing, and locks it. Returns `None` if another process has the lock.
    ///
    /// # Errors
    /// When the file cannot be opened or locked.
    pub(crate) fn try_acquire(path: &Path) -> io::Result<Option<Self>> {
        let file = File::options().create(true).append(true).open(path)?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self { _file: file })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }
}
