//! Errors of result folders.

use std::path::PathBuf;

use peernet_analysis::WriteError;

/// Reason that a result folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The folder is not empty, and nothing may be replaced.
    #[error(
        "{} holds files already; name another folder with --result-loc, add --overwrite to replace results in it, or remove it",
        .0.display()
    )]
    NotEmpty(PathBuf),
    /// Another program writes its results there.
    #[error("another peernet is writing its results to {}; wait for it, end it or name another folder", .0.display())]
    Busy(PathBuf),
    /// The path leads to a file.
    #[error("{} is no folder", .0.display())]
    NotAFolder(PathBuf),
    /// The folder cannot be created.
    #[error("cannot make the folder {}: {reason}", path.display())]
    Create {
        /// Path of the folder.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// The folder has no `data.csv`.
    #[error("{} holds no results: there is no data.csv in it", .0.display())]
    NoResults(PathBuf),
    /// A file in the folder cannot be read.
    #[error("cannot read {}: {reason}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// A file in the folder cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}
