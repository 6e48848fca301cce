//! A check that the paths of the database and of its log still name the open files.
//!
//! The writer makes this check before and after each commit, and once a second, because data that is written to a moved
//! or deleted file would be lost.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::database_error::DatabaseError;

/// Reason why a commit failed, or why its data may be lost.
#[derive(Debug, thiserror::Error)]
pub enum CommitError {
    /// The path names another file or no file: data that is written now is lost when this process ends.
    #[error("the database file {} was deleted, moved or replaced, or its file system is not mounted; put it back, or restart the aggregator to use the file that is there now", .0.display())]
    Moved(PathBuf),
    /// The path of the write-ahead log names another file or no file: data that is written now is lost when this
    /// process is killed.
    #[error("the write-ahead log {} of the database was deleted, moved or replaced while it was in use", .0.display())]
    LogMoved(PathBuf),
    /// The file is damaged. The text describes the damage and what to do.
    #[error("{0}")]
    Damaged(String),
    /// The disk is full, or another program locks the database. The same commit may succeed later.
    #[error("cannot write to the database {}: {error}; {}", .path.display(), .error.remedy())]
    Refused {
        /// Path of the database.
        path: PathBuf,
        /// Error of SQLite.
        error: DatabaseError,
    },
    /// SQLite reported an error.
    #[error(transparent)]
    Database(#[from] DatabaseError),
}

impl CommitError {
    /// Returns whether the connection can be used again: the disk is full, another program locks the database, or the
    /// file is damaged.
    ///
    /// The connection to a damaged file is kept until another file is put in its place. After any other error the file
    /// has to be opened again. The error may come from the open file: even if the path is usable again, the open file
    /// may still not be writable, or may belong to a file system that is no longer mounted.
    pub fn leaves_connection_usable(&self) -> bool {
        match self {
            Self::Database(error) => error.is_transient(),
            Self::Damaged(_) | Self::Refused { .. } => true,
            Self::Moved(_) | Self::LogMoved(_) => false,
        }
    }
}

/// Device and inode of a file.
// An inode number is unique on its device only.
type Identity = (u64, u64);

/// The open file of the database, and its log.
#[derive(Debug)]
pub(super) struct DatabaseFile {
    path: PathBuf,
    identity: Identity,
    log_path: PathBuf,
    /// Identity of the write-ahead log; `None` if there was no log although the connection had read. SQLite creates the
    /// log with the first connection and removes it with the last connection. While the writer is connected, the log is
    /// the same file, even if it is checkpointed and written from its start again.
    log: Option<Identity>,
}

impl DatabaseFile {
    /// Records the identities of the current files. A connection must have read from the database before.
    pub(super) fn open(path: PathBuf) -> std::io::Result<Self> {
        let identity = identity(&path)?;
        let mut log_path = path.clone().into_os_string();
        log_path.push("-wal");
        let log = self::identity(log_path.as_ref()).ok();
        Ok(Self { path, identity, log_path: log_path.into(), log })
    }

    /// Returns the error of a commit that SQLite refused.
    pub(super) fn commit_error(&self, error: DatabaseError) -> CommitError {
        match error.is_transient() {
            true => CommitError::Refused { path: self.path.clone(), error },
            false => error.into(),
        }
    }

    /// Returns the path of the write-ahead log.
    pub(super) fn log_path(&self) -> &Path {
        &self.log_path
    }

    /// Checks that the paths still name the files. The check reads only the file system's cache, which is cheap
    /// compared with a commit.
    pub(super) fn check(&self) -> Result<(), CommitError> {
        if identity(&self.path).ok() != Some(self.identity) {
            return Err(CommitError::Moved(self.path.clone()));
        }
        match self.log {
            Some(log) if identity(&self.log_path).ok() == Some(log) => Ok(()),
            _ => Err(CommitError::LogMoved(self.log_path.clone())),
        }
    }
}

/// The files of a closed database.
#[derive(Debug)]
pub struct FormerFiles(DatabaseFile);

impl FormerFiles {
    pub(super) const fn new(file: DatabaseFile) -> Self {
        Self(file)
    }

    /// Returns the path of the write-ahead log if another file has replaced the database file, but the log of the former
    /// database is still there and not empty.
    pub fn leftover_log(&self) -> Option<PathBuf> {
        let Self(file) = self;
        let is_replaced = identity(&file.path).ok() != Some(file.identity);
        let current_log = std::fs::metadata(&file.log_path).ok()?;
        let former_log_has_data =
            Some((current_log.dev(), current_log.ino())) == file.log && current_log.len() > 0;
        (is_replaced && former_log_has_data).then(|| file.log_path.clone())
    }
}

fn identity(path: &Path) -> std::io::Result<Identity> {
    std::fs::metadata(path).map(|file| (file.dev(), file.ino()))
}
