//! Whether the paths of the database and of its log still name the files that are open.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Why a commit did not count.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CommitError {
    /// The path names another file or none: what is written now is lost when this process ends.
    #[error("the database file {} was deleted, moved or replaced while it was in use; put it back, or restart to go on with what is there", .0.display())]
    Moved(PathBuf),
    /// The path of the log names another file or none: what is written now is lost when this process is killed.
    #[error("the log {} of the database was deleted, moved or replaced while it was in use; restart to go on with what is in the main file, what agents still hold is sent again", .0.display())]
    LogMoved(PathBuf),
    /// SQLite's own words.
    #[error(transparent)]
    Database(#[from] sqlx::Error),
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

    /// Its path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Another connection is to be made.
    pub(super) fn forget_log(&mut self) {
        self.log = Log::Unknown;
    }

    /// Remembers the log of a new connection, which has committed or read.
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

fn identity(path: &Path) -> std::io::Result<Identity> {
    std::fs::metadata(path).map(|file| (file.dev(), file.ino()))
}
