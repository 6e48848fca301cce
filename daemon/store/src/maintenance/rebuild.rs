//! Rebuilding of roll-ups from the nodes, by an operator.

use std::path::{Path, PathBuf};

use sqlx::Connection;

use crate::database;
use crate::database_error::DatabaseError;
use crate::error::OpenError;
use crate::foreign_log::refuse_foreign_log;
use crate::lock::{DatabaseLock, LockError};
pub use crate::rebuild::Rebuilt;
use crate::rebuild::rebuild;

/// Reason why roll-ups were not rebuilt.
#[derive(Debug, thiserror::Error)]
pub enum RebuildError {
    /// The database does not exist.
    #[error("there is no database {}; give the file that the key `database` of [aggregator] names", .0.display())]
    Missing(PathBuf),
    /// The database cannot be locked. Usually an aggregator holds the lock.
    #[error("cannot rebuild roll-ups without the lock of the database: {0}")]
    Lock(#[from] LockError),
    /// The database cannot be opened or brought up to date.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The run does not exist.
    #[error("the database {} has no run #{run}", path.display())]
    NoRun {
        /// The database.
        path: PathBuf,
        /// Number of the run.
        run: i64,
    },
    /// SQLite reported an error.
    #[error("cannot rebuild roll-ups in the database {}: {source}; the runs that were finished have new roll-ups, and all other runs are unchanged", path.display())]
    Database {
        /// The database.
        path: PathBuf,
        /// SQLite's error.
        source: DatabaseError,
    },
}

/// Makes the roll-ups of one run, or of all runs (`None`), from the nodes that still exist. `progress` is called after
/// every few hundred iterations, and after each run.
///
/// # Errors
/// When the aggregator runs, or the database cannot be read or written. Runs whose rebuild was complete before the error
/// keep their new roll-ups.
pub async fn rebuild_rollups(
    path: &Path,
    run: Option<i64>,
    progress: impl FnMut(&Rebuilt),
) -> Result<Rebuilt, RebuildError> {
    if !path.is_file() {
        return Err(RebuildError::Missing(path.to_owned()));
    }
    let lock = DatabaseLock::take(path)?;
    refuse_foreign_log(path, &lock.file()).map_err(OpenError::from)?;
    let failed = |error: sqlx::Error| RebuildError::Database {
        path: path.to_owned(),
        source: DatabaseError::new(error),
    };
    let mut connection = database::open(path).await?;
    if let Some(run) = run {
        let exists = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM run WHERE number = ?1)").bind(run);
        if !exists.fetch_one(&mut connection).await.map_err(failed)? {
            return Err(RebuildError::NoRun { path: path.to_owned(), run });
        }
    }
    let rebuilt = rebuild(&mut connection, run, progress).await.map_err(failed)?;
    connection.close().await.map_err(failed)?;
    Ok(rebuilt)
}
