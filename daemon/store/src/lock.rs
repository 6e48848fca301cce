//! Exclusive lock of a database. While a process holds the lock, a second aggregator or a command that rewrites the
//! file is refused.

use std::fs::{File, Metadata, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Reason why a database could not be locked.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process holds the lock.
    #[error("the database {} is in use by {holder}; stop that process, or name another file", path.display())]
    Taken {
        /// The database.
        path: PathBuf,
        /// Description of the other process, with its pid if the kernel lists the lock.
        holder: String,
    },
    /// The file cannot be created, opened or locked.
    #[error("cannot lock {}: {source}; check that its folder exists and that this user may write there", path.display())]
    Failed {
        /// The database.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

/// Lock of a database for writing: a lock on the file itself, which is released when this value is dropped or the
/// process ends.
///
/// A file has one lock under all its names (symbolic link, hard link, another mount).
//
// The lock is made with flock(2), because SQLite makes its own locks with fcntl(2). When SQLite closes one of its
// descriptors of the file, this lock stays. The reverse does not hold: closing *this* descriptor would release all
// locks that SQLite holds with fcntl in this process. Therefore this descriptor is closed after SQLite's last
// connection.
#[derive(Debug)]
pub struct DatabaseLock {
    file: Arc<File>,
}

impl DatabaseLock {
    /// Locks the database; creates the file if it is missing. The folder of the file must exist.
    ///
    /// # Errors
    /// When another process holds the lock, or the file cannot be opened for writing.
    pub fn take(database: &Path) -> Result<Self, LockError> {
        Self::open(database, File::options().create(true))
    }

    /// Locks a database that must exist.
    pub(crate) fn take_existing(database: &Path) -> Result<Self, LockError> {
        Self::open(database, &mut File::options())
    }

    /// Opens the file for reading and writing, and locks the file.
    fn open(database: &Path, options: &mut OpenOptions) -> Result<Self, LockError> {
        let failed = |source| LockError::Failed { path: database.to_owned(), source };
        let file = options.truncate(false).read(true).write(true).open(database).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { file: Arc::new(file) }),
            Err(TryLockError::WouldBlock) => {
                let holder = file.metadata().ok().and_then(|file| holder(&file));
                let holder = holder.map_or_else(
                    || "another process".to_owned(),
                    |process| format!("another process (pid {process})"),
                );
                Err(LockError::Taken { path: database.to_owned(), holder })
            }
            Err(TryLockError::Error(error)) => Err(failed(error)),
        }
    }

    /// Returns the locked file for reading. The caller has to drop the returned value before the lock.
    // Code that reads the file without SQLite uses this descriptor: if the process closed a separate descriptor of the
    // file, SQLite would lose its own locks on the file.
    pub(crate) fn file(&self) -> Arc<File> {
        Arc::clone(&self.file)
    }

    /// Returns whether a path leads to the locked file.
    pub(crate) fn is_lock_of(&self, path: &Path) -> io::Result<bool> {
        let identity = |file: Metadata| (file.dev(), file.ino());
        Ok(identity(self.file.metadata()?) == identity(std::fs::metadata(path)?))
    }
}

/// Returns the process that holds the lock of a file, from the kernel's list of locks. A line of the list is
/// `1: FLOCK  ADVISORY  WRITE 1234 fe:00:5678 0 EOF`, with the process, the device and the inode.
fn holder(file: &Metadata) -> Option<u32> {
    let (device, inode) = (file.dev(), file.ino());
    let file_id = format!("{:02x}:{:02x}:{inode}", rustix::fs::major(device), rustix::fs::minor(device));
    // The kernel returns the list in parts. A line is missing if locks before that line are released between two parts.
    // Therefore the list is read up to five times.
    (0..5).find_map(|_| {
        let locks = std::fs::read_to_string("/proc/locks").ok()?;
        locks.lines().find_map(|line| {
            let mut words = line.split_whitespace().skip(1);
            let (kind, process, locked_file) = (words.next()?, words.nth(2)?, words.next()?);
            (kind == "FLOCK" && locked_file == file_id).then(|| process.parse().ok()).flatten()
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn database_has_one_holder_under_any_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("peernet.sqlite");
        assert!(matches!(DatabaseLock::take_existing(&path), Err(LockError::Failed { .. })));
        let first = DatabaseLock::take(&path).expect("the lock is free");
        let refused = DatabaseLock::take(&path).expect_err("the lock is held").to_string();
        assert!(refused.contains(&format!("pid {}", std::process::id())), "{refused}");

        let (link, hard_link) = (folder.path().join("link.sqlite"), folder.path().join("hard.sqlite"));
        std::os::unix::fs::symlink(&path, &link).expect("a link");
        std::fs::hard_link(&path, &hard_link).expect("a hard link");
        for name in [&link, &hard_link] {
            assert!(matches!(DatabaseLock::take(name), Err(LockError::Taken { .. })));
            assert!(first.is_lock_of(name).expect("the file exists"));
        }

        drop(first);
        let second = DatabaseLock::take(&hard_link).expect("the lock was released");
        let other = folder.path().join("other.sqlite");
        DatabaseLock::take(&other).expect("the other file has its own lock");
        assert!(!second.is_lock_of(&other).expect("the file exists"));
    }

    #[test]
    fn error_names_missing_folder() {
        let folder = tempfile::tempdir().expect("a folder");
        let refused = DatabaseLock::take(&folder.path().join("no/peernet.sqlite")).expect_err("no folder");
        assert!(refused.to_string().contains("no/peernet.sqlite"), "{refused}");
    }
}
