//! Locks on files.

use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;

/// An exclusive lock on a file, released when this value is dropped or the process ends in any way.
///
/// The file is not removed. Otherwise two processes could lock two different files of the same name.
#[derive(Debug)]
pub(crate) struct FileLock {
    file: File,
}

impl FileLock {
    /// Creates the file if it is missing, and locks it. Returns `None` if another process has the lock.
    ///
    /// # Errors
    /// When the file cannot be opened or locked.
    pub(crate) fn try_acquire(path: &Path) -> io::Result<Option<Self>> {
        let file = File::options().create(true).append(true).open(path)?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self { file })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }
}

impl Drop for FileLock {
    fn drop(&mut self) {
        // Closing the file would not release the lock while a child process has a copy of the descriptor. A child has a
        // copy from its creation until it executes its program.
        if let Err(error) = self.file.unlock() {
            tracing::warn!(%error, file = ?self.file, "cannot unlock a file; it stays locked until the last process that opened it closes it");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lock_ends_although_a_child_has_a_copy_of_the_descriptor() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lock");
        let lock = FileLock::try_acquire(&path).expect("can be opened").expect("is free");
        let copy = lock.file.try_clone().expect("can be copied");
        assert!(FileLock::try_acquire(&path).expect("can be opened").is_none());
        drop(lock);
        assert!(FileLock::try_acquire(&path).expect("can be opened").is_some());
        drop(copy);
    }
}
