//! What can go wrong with folders of results.

use std::path::PathBuf;

use peernet_analysis::WriteError;

/// A folder of results that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// It holds something, and nothing may be replaced.
    #[error(
        "{} holds files already; name another folder with --result-loc, add --overwrite to replace results in it, or remove it",
        .0.display()
    )]
    NotEmpty(PathBuf),
    /// Another program writes its results there.
    #[error("another peernet is writing its results to {}; wait for it, end it or name another folder", .0.display())]
    Busy(PathBuf),
    /// It is a file.
    #[error("{} is no folder", .0.display())]
    NoFolder(PathBuf),
    /// It cannot be made.
    #[error("cannot make the folder {}: {reason}", path.display())]
    Make {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// It has no `data.csv`.
    #[error("{} holds no results: there is no data.csv in it", .0.display())]
    NoResults(PathBuf),
    /// A file of it cannot be read.
    #[error("cannot read {}: {reason}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A file of it cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}
