//! Whether the paths of the database and of its log still name the files that are open.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::database_error::DatabaseError;

/// Why a commit did not count.
#[derive(Debug, thiserror::Error)]
pub enum CommitError {
    /// The path names another file or none: what is written now is lost when this process ends.
    #[error("the database file {} was deleted, moved or replaced, or its file system is not mounted; put it back, or restart to begin with what is there", .0.display())]
    Moved(PathBuf),
    /// The path of the log names another file or none: what is written now is lost when this process is killed.
    #[error("the log {} of the database was deleted, moved or replaced while it was in use", .0.display())]
    LogMoved(PathBuf),
    /// The file is damaged: what it is, and what to do.
    #[error("{0}")]
    Damaged(String),
    /// SQLite's own words.
    #[error(transparent)]
    Database(#[from] DatabaseError),
}

impl CommitError {
    /// Whether the connection is as good as before: the database is full or another program locks it. One to a damaged
    /// file is kept until another file is put in its place. After anything
    /// else the file is opened anew: the error may be one of the descriptors alone, which stay read-only, or lead to a
    /// file system that is gone, long after the path is well again.
    pub fn leaves_connection_usable(&self) -> bool {
        match self {
            Self::Database(error) => error.is_passing(),
            Self::Damaged(_) => true,
            Self::Moved(_) | Self::LogMoved(_) => false,
        }
    }
}

/// Device and inode.
type Identity = (u64, u64);

/// The file that was opened, and the log beside it.
#[derive(Debug)]
pub(super) struct DatabaseFile {
    path: PathBuf,
    identity: Identity,
    log_path: PathBuf,
    /// Which file the log is. SQLite makes it with the first connection and removes it with the last: while the writer
    /// has one it stays the same, however often it is carried over and begun again.
    log: Log,
}

#[derive(Debug)]
enum Log {
    /// Not looked for since the connection was made.
    Unknown,
    /// As it was found; `None` when there was none although something had been committed.
    Found(Option<Identity>),
}

impl DatabaseFile {
    /// Remembers which files are there now, with a connection that has read.
    pub(super) fn of(path: PathBuf) -> std::io::Result<Self> {
        let identity = identity(&path)?;
        let mut log_path = path.clone().into_os_string();
        log_path.push("-wal");
        let mut file = Self { path, identity, log_path: log_path.into(), log: Log::Unknown };
        file.remember_log();
        Ok(file)
    }

    /// Path of the log.
    pub(super) fn log_path(&self) -> &Path {
        &self.log_path
    }

    /// Remembers the log of a connection which has committed or read.
    pub(super) fn remember_log(&mut self) {
        if matches!(self.log, Log::Unknown) {
            self.log = Log::Found(identity(&self.log_path).ok());
        }
    }

    /// Whether the paths still name them: a few words of the file system's cache, cheap beside any commit.
    pub(super) fn check(&self) -> Result<(), CommitError> {
        if identity(&self.path).ok() != Some(self.identity) {
            return Err(CommitError::Moved(self.path.clone()));
        }
        match self.log {
            Log::Unknown => Ok(()),
            Log::Found(Some(log)) if identity(&self.log_path).ok() == Some(log) => Ok(()),
            Log::Found(_) => Err(CommitError::LogMoved(self.log_path.clone())),
        }
    }
}

/// The files of a database that was closed.
#[derive(Debug)]
pub struct FormerFiles(DatabaseFile);

impl FormerFiles {
    pub(super) const fn new(file: DatabaseFile) -> Self {
        Self(file)
    }

    /// Path of the log when it still stands where it was, with something in it, while the database was replaced.
    pub fn log_beside_another_file(&self) -> Option<PathBuf> {
        let Self(file) = self;
        let replaced = identity(&file.path).ok() != Some(file.identity);
        let Log::Found(Some(log)) = file.log else { return None };
        let there = std::fs::metadata(&file.log_path).ok()?;
        let same = (there.dev(), there.ino()) == log && there.len() > 0;
        (replaced && same).then(|| file.log_path.clone())
    }
}

fn identity(path: &Path) -> std::io::Result<Identity> {
    std::fs::metadata(path).map(|file| (file.dev(), file.ino()))
}
