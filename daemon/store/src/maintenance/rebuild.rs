//! Roll-ups made anew from the nodes, by an operator.

use std::path::{Path, PathBuf};

use sqlx::Connection;

use crate::database;
use crate::database_error::DatabaseError;
use crate::error::OpenError;
use crate::foreign_log::refuse_foreign_log;
use crate::lock::{DatabaseLock, LockError};
pub use crate::rebuild::Rebuilt;
use crate::rebuild::rebuild;

/// Why roll-ups were not made anew.
#[derive(Debug, thiserror::Error)]
pub enum RebuildError {
    /// There is no such database.
    #[error("there is no database {}; name the file of [aggregator] database", .0.display())]
    Missing(PathBuf),
    /// Another process has it, most likely the aggregator.
    #[error("cannot rebuild roll-ups while another process may store: {0}")]
    Lock(#[from] LockError),
    /// It cannot be opened or brought up to date.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// There is no such run.
    #[error("the database {} has no run #{run}", path.display())]
    NoRun {
        /// The database.
        path: PathBuf,
        /// Its number.
        run: i64,
    },
    /// SQLite refused.
    #[error("cannot rebuild roll-ups in the database {}: {source}; the runs that were done are done, the others as before", path.display())]
    Database {
        /// The database.
        path: PathBuf,
        /// SQLite's own words.
        source: DatabaseError,
    },
}

/// Makes the roll-ups of one run, or of all, from its nodes as far as they still exist. `progress` is told of what is
/// done, the successful iterations among it, after each few thousand.
///
/// # Errors
/// When the aggregator runs, or the database cannot be read or written; runs that are done stay done.
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
        let known = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM run WHERE number = ?1)").bind(run);
        if !known.fetch_one(&mut connection).await.map_err(failed)? {
            return Err(RebuildError::NoRun { path: path.to_owned(), run });
        }
    }
    let rebuilt = rebuild(&mut connection, run, progress).await.map_err(failed)?;
    connection.close().await.map_err(failed)?;
    Ok(rebuilt)
}
