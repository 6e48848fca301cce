//! Whether the database's path still names the file that is open.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Why a commit did not count.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CommitError {
    /// The path names another file or none: what is written now is lost when this process ends.
    #[error("the database file {} was deleted, moved or replaced while it was in use; put it back, or restart to go on with what is there", .0.display())]
    Moved(PathBuf),
    /// SQLite's own words.
    #[error(transparent)]
    Database(#[from] sqlx::Error),
}

/// The file that was opened.
#[derive(Debug)]
pub(super) struct DatabaseFile {
    path: PathBuf,
    identity: (u64, u64),
}

impl DatabaseFile {
    /// Remembers which file a path names now.
    pub(super) fn of(path: PathBuf) -> std::io::Result<Self> {
        let identity = identity(&path)?;
        Ok(Self { path, identity })
    }

    /// Its path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the path still names it: two words of the file system's cache, cheap beside any commit.
    pub(super) fn check(&self) -> Result<(), CommitError> {
        match identity(&self.path) {
            Ok(identity) if identity == self.identity => Ok(()),
            _ => Err(CommitError::Moved(self.path.clone())),
        }
    }
}

fn identity(path: &Path) -> std::io::Result<(u64, u64)> {
    std::fs::metadata(path).map(|file| (file.dev(), file.ino()))
}
