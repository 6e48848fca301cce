//! Errors of result folders.

use std::path::PathBuf;

use peernet_analysis::WriteError;

/// Reason why a result folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The folder is not empty, and its files must not be replaced.
    #[error(
        "the folder {} is not empty; name another folder with --result-loc, add --overwrite to replace the results in it, or remove the folder",
        .0.display()
    )]
    NotEmpty(PathBuf),
    /// Another process writes its results to the folder.
    #[error("another peernet is writing its results to {}; wait until it ends, stop it or name another folder", .0.display())]
    Busy(PathBuf),
    /// The path is not a folder.
    #[error("{} is not a folder", .0.display())]
    NotAFolder(PathBuf),
    /// The folder cannot be created, opened or listed.
    #[error("cannot create or open the folder {}: {reason}", path.display())]
    Open {
        /// Path of the folder.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// The folder has no `data.csv`.
    #[error("{} contains no results: it has no data.csv", .0.display())]
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
