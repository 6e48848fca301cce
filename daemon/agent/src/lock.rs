//! Files that say that something is in use.

use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;

/// A lock on a file; let go when this is dropped or the process ends, however it ends. The file stays, because removing
/// it would let two processes lock two files.
#[derive(Debug)]
pub(crate) struct FileLock {
    _file: File,
}

impl FileLock {
    /// Takes the lock on the file, which is made when missing; `None` when another has it.
    pub(crate) fn take(path: &Path) -> io::Result<Option<Self>> {
        let file = File::options().create(true).append(true).open(path)?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self { _file: file })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }
}
