//! One writer per database: a second aggregator, or a command that rewrites, is refused while the first is there.

use std::fs::{File, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};

/// Why a database could not be taken.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process has it.
    #[error("the database {} is in use by {holder}; stop it, or name another file", path.display())]
    Taken {
        /// The database.
        path: PathBuf,
        /// Who has it, as far as it said.
        holder: String,
    },
    /// The file beside the database cannot be made or locked.
    #[error("cannot lock {}: {source}; check that its folder exists and that this user may write there", path.display())]
    Failed {
        /// The file that is locked.
        path: PathBuf,
        /// The system's own words.
        source: io::Error,
    },
}

/// The right to write to a database: a lock on the file `<database>-lock` beside it, let go when this is dropped or the
/// process ends, however it ends. The file stays, because removing it would let two processes lock two files.
#[derive(Debug)]
pub struct DatabaseLock {
    _file: File,
}

impl DatabaseLock {
    /// Takes the database. Its folder must exist, the database itself need not.
    ///
    /// # Errors
    /// When another process has it, or the file beside it cannot be made.
    pub fn take(database: &Path) -> Result<Self, LockError> {
        let path = lock_file(database);
        let failed = |source| LockError::Failed { path: path.clone(), source };
        let mut file = File::options()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .open(&path)
            .map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let holder = holder(&mut file);
                return Err(LockError::Taken { path: database.to_owned(), holder });
            }
            Err(TryLockError::Error(error)) => return Err(failed(error)),
        }
        // For people alone: who holds the lock is told by the kernel.
        let write = file
            .set_len(0)
            .and_then(|()| file.rewind())
            .and_then(|()| writeln!(file, "{}", std::process::id()));
        write.map_err(failed)?;
        Ok(Self { _file: file })
    }
}

/// The file that is locked: beside the database itself, also when it is named by a link.
fn lock_file(database: &Path) -> PathBuf {
    let mut path = std::fs::canonicalize(database).unwrap_or_else(|_| database.to_owned()).into_os_string();
    path.push("-lock");
    path.into()
}

fn holder(file: &mut File) -> String {
    let mut text = String::new();
    let read = file.take(32).read_to_string(&mut text);
    match (read, text.trim().parse::<u32>()) {
        (Ok(_), Ok(pid)) => format!("another process (pid {pid})"),
        _ => "another process".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_database_has_one_holder_at_a_time_by_whatever_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("peernet.sqlite");
        let first = DatabaseLock::take(&path).expect("nobody has it");
        let refused = DatabaseLock::take(&path).expect_err("one has it").to_string();
        assert!(refused.contains(&format!("pid {}", std::process::id())), "{refused}");

        File::create(&path).expect("a file");
        let link = folder.path().join("link.sqlite");
        std::os::unix::fs::symlink(&path, &link).expect("a link");
        assert!(matches!(DatabaseLock::take(&link), Err(LockError::Taken { .. })));

        drop(first);
        DatabaseLock::take(&link).expect("it was let go");
        DatabaseLock::take(&folder.path().join("other.sqlite")).expect("nobody has the other");
    }

    #[test]
    fn a_folder_that_is_not_there_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let refused = DatabaseLock::take(&folder.path().join("no/peernet.sqlite")).expect_err("no folder");
        assert!(refused.to_string().contains("no/peernet.sqlite-lock"), "{refused}");
    }
}
