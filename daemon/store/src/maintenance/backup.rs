//! Copy of the database at one moment, made while the aggregator continues to store.

use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, RenameFlags, renameat_with};
use rustix::io::Errno;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use tokio_util::sync::CancellationToken;

use super::{FileKind, free_bytes, read_only_options};
use crate::column::count;
use crate::database_error::DatabaseError;
use crate::foreign_log::{ForeignLog, assign_new_id, refuse_foreign_log_at};

/// Instructions of SQLite's virtual machine between two checks whether to stop.
const INSTRUCTIONS_PER_CHECK: i32 = 10_000;

/// Reason why no copy was made.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// The database does not exist.
    #[error("there is no database {}; give the file that the key `database` of [aggregator] names", .0.display())]
    Missing(PathBuf),
    /// The database cannot be read.
    #[error("cannot read the database {}: {source}", path.display())]
    Read {
        /// The database.
        path: PathBuf,
        /// SQLite's error.
        source: DatabaseError,
    },
    /// The file is of another kind.
    #[error("{} is {what} and not an aggregator's database; give the file that the key `database` of [aggregator] names", path.display())]
    NotADatabase {
        /// The file.
        path: PathBuf,
        /// Kind of the file.
        what: &'static str,
    },
    /// The write-ahead log of another database lies beside the file.
    #[error(transparent)]
    ForeignLog(#[from] ForeignLog),
    /// A file with the copy's name exists.
    #[error("{} already exists; name a file that does not exist", .0.display())]
    Exists(PathBuf),
    /// Another process writes the same copy.
    #[error("another backup writes to {}; wait for it, or name another file", .0.display())]
    UnderWay(PathBuf),
    /// The path cannot be given to SQLite.
    #[error("{} is not UTF-8; name another file", .0.display())]
    Name(PathBuf),
    /// The disk has not enough space for the copy.
    #[error("{} has {free} bytes free, but the copy needs {needed}; free some space, or name a file on another disk", folder.display())]
    NoRoom {
        /// The folder of the copy.
        folder: PathBuf,
        /// Number of bytes needed.
        needed: u64,
        /// Number of bytes free.
        free: u64,
    },
    /// The copy cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The copy.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// SQLite could not read the database or write the copy.
    #[error("cannot copy {} to {}: {source}", from.display(), to.display())]
    Copy {
        /// The database.
        from: PathBuf,
        /// The unfinished copy.
        to: PathBuf,
        /// SQLite's error.
        source: DatabaseError,
    },
    /// The copying was stopped.
    #[error("the backup was stopped; no copy was made")]
    Stopped,
}

/// A finished copy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FinishedCopy {
    /// Path of the copy.
    pub path: PathBuf,
    /// Size of the copy, bytes.
    pub bytes: u64,
}

/// A backup whose preconditions were checked.
#[derive(Debug)]
pub struct Backup {
    database: PathBuf,
    target: PathBuf,
    connection: SqliteConnection,
    partial_copy: UnfinishedCopy,
    expected_bytes: u64,
}

impl Backup {
    /// Checks that `database` can be read, that `target` does not exist, and that the target's disk
    /// has space. Then creates the file `<target>.partial`, to which the copy is written first.
    ///
    /// # Errors
    /// When a check fails, or the file cannot be created.
    pub async fn prepare(database: &Path, target: &Path) -> Result<Self, BackupError> {
        if !database.is_file() {
            return Err(BackupError::Missing(database.to_owned()));
        }
        // `exists` is not used: a broken symbolic link would count as missing.
        if target.symlink_metadata().is_ok() {
            return Err(BackupError::Exists(target.to_owned()));
        }
        let read_error = |error: sqlx::Error| BackupError::Read {
            path: database.to_owned(),
            source: DatabaseError::new(error),
        };
        refuse_foreign_log_at(database)?;
        let mut connection = read_only_options(database).connect().await.map_err(read_error)?;
        let kind = FileKind::detect(&mut connection).await.map_err(read_error)?;
        if let Some(what) = kind.other_kind() {
            return Err(BackupError::NotADatabase { path: database.to_owned(), what });
        }
        // `VACUUM INTO` writes no free pages.
        let used: i64 = sqlx::query_scalar(
            "SELECT (page_count - freelist_count) * page_size \
             FROM pragma_page_count, pragma_freelist_count, pragma_page_size",
        )
        .fetch_one(&mut connection)
        .await
        .map_err(read_error)?;
        let expected_bytes = count(used);
        // A relative path may be a file name alone. Its parent would be an empty path.
        let target = std::path::absolute(target)
            .map_err(|source| BackupError::Write { path: target.to_owned(), source })?;
        let folder = target.parent().unwrap_or(&target).to_owned();
        let free =
            free_bytes(&folder).map_err(|source| BackupError::Write { path: folder.clone(), source })?;
        if free < expected_bytes {
            return Err(BackupError::NoRoom { folder, needed: expected_bytes, free });
        }
        let partial_copy = UnfinishedCopy::create(&target)?;
        Ok(Self { database: database.to_owned(), target, connection, partial_copy, expected_bytes })
    }

    /// Returns the approximate size of the copy.
    pub fn expected_bytes(&self) -> u64 {
        self.expected_bytes
    }

    /// Returns the path of the unfinished copy, a file that grows while the copy is made.
    pub fn partial(&self) -> &Path {
        &self.partial_copy.path
    }

    /// Makes the copy. After success, the copy is on the disk at the target. After a failure, no file is left.
    ///
    /// # Errors
    /// When `stop` is cancelled before the end, or the copy cannot be written.
    pub async fn run(self, stop: CancellationToken) -> Result<FinishedCopy, BackupError> {
        let Self { database, target, mut connection, mut partial_copy, .. } = self;
        let name = partial_copy.path.to_str().ok_or_else(|| BackupError::Name(partial_copy.path.clone()))?;
        let handler_stop = stop.clone();
        let copy = async {
            let continues = move || !handler_stop.is_cancelled();
            connection.lock_handle().await?.set_progress_handler(INSTRUCTIONS_PER_CHECK, continues);
            sqlx::query("VACUUM INTO ?1").bind(name).execute(&mut connection).await?;
            connection.close().await
        };
        let result = copy.await;
        // If the handler stopped SQLite, `result` is an error, too. `stop` is therefore checked first.
        if stop.is_cancelled() {
            return Err(BackupError::Stopped);
        }
        result.map_err(|error| BackupError::Copy {
            from: database,
            to: partial_copy.path.clone(),
            source: DatabaseError::new(error),
        })?;
        let bytes = partial_copy.publish(&target)?;
        Ok(FinishedCopy { path: target, bytes })
    }
}

/// The file of the unfinished copy. It is locked against other processes, and removed unless it is published.
#[derive(Debug)]
struct UnfinishedCopy {
    path: PathBuf,
    file: File,
    is_published: bool,
}

impl UnfinishedCopy {
    /// Creates and locks the file. A file that a killed process left behind is emptied. Fails if a running process
    /// writes to the file.
    fn create(target: &Path) -> Result<Self, BackupError> {
        let mut path = target.as_os_str().to_owned();
        path.push(".partial");
        let path = PathBuf::from(path);
        let write_error = |source| BackupError::Write { path: path.clone(), source };
        let opened = File::options().create(true).truncate(false).read(true).write(true).open(&path);
        let file = opened.map_err(write_error)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(BackupError::UnderWay(path)),
            Err(TryLockError::Error(error)) => return Err(write_error(error)),
        }
        // `VACUUM INTO` writes a copy only to an empty file.
        file.set_len(0).map_err(write_error)?;
        Ok(Self { path, file, is_published: false })
    }

    /// Gives the copy a new database id, syncs it, renames it, and syncs the folder. Returns the size of the copy.
    fn publish(&mut self, target: &Path) -> Result<u64, BackupError> {
        let write_error = |source| BackupError::Write { path: target.to_owned(), source };
        assign_new_id(&self.file).map_err(write_error)?;
        // The copy is synced before it is renamed, so that a file with the target's name is always complete.
        self.file.sync_all().map_err(write_error)?;
        let bytes = self.file.metadata().map_err(write_error)?.len();
        rename(&self.path, target).map_err(|error| match error.kind() {
            ErrorKind::AlreadyExists => BackupError::Exists(target.to_owned()),
            _ => write_error(error),
        })?;
        self.is_published = true;
        let folder = target.parent().unwrap_or(target);
        // A new name is on the disk only when its folder is synced (fsync(2)).
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(write_error)?;
        Ok(bytes)
    }
}

impl Drop for UnfinishedCopy {
    fn drop(&mut self) {
        if !self.is_published
            && let Err(error) = fs::remove_file(&self.path)
        {
            tracing::warn!(%error, file = %self.path.display(), "cannot remove an unfinished backup");
        }
    }
}

/// Renames without replacing another file.
fn rename(from: &Path, to: &Path) -> io::Result<()> {
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // Some file systems do not support the flag.
        Err(Errno::INVAL) => rename_after_check(from, to),
        renamed => renamed.map_err(io::Error::from),
    }
}

/// Renames if no file has the new name. A file that is created after the check is replaced.
fn rename_after_check(from: &Path, to: &Path) -> io::Result<()> {
    // `prepare` found the name free, but another program may have created a file during the backup.
    if to.symlink_metadata().is_ok() {
        return Err(Errno::EXIST.into());
    }
    fs::rename(from, to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checked_rename_fails_if_target_exists() {
        let folder = tempfile::tempdir().expect("a folder");
        let [copy, target] = ["copy", "target"].map(|name| folder.path().join(name));
        fs::write(&copy, "ours").expect("writable");
        fs::write(&target, "theirs").expect("writable");
        let error = rename_after_check(&copy, &target).expect_err("the target exists");
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&target).expect("is there"), b"theirs");

        fs::remove_file(&target).expect("removable");
        rename_after_check(&copy, &target).expect("the name is free");
        assert_eq!(fs::read(&target).expect("is there"), b"ours");
    }
}
