//! Errors of the store. Each text says what was tried, on which file, and what to do.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::database_error::{DatabaseError, is_damage, is_partial_damage};
use crate::foreign_log::ForeignLog;
use crate::integrity::{has_table_list, remedy};
use crate::lock::LockError;

/// Reason why a database cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The database cannot be opened.
    #[error("cannot open the database {}: {source}; check that its folder exists and that this user may write there", path.display())]
    Open {
        /// The configured file.
        path: PathBuf,
        /// SQLite's error.
        source: DatabaseError,
    },
    /// A part of the database that is read at the start is damaged.
    #[error("cannot open the database {}: it is damaged: {source}; agents keep their events; {}", path.display(), remedy(path, *is_repairable))]
    Damaged {
        /// The configured file.
        path: PathBuf,
        /// SQLite's error.
        source: DatabaseError,
        /// `true` if rows can be found in the file.
        is_repairable: bool,
    },
    /// The file has no database header, or no longer has one.
    #[error("cannot open the database {}: {source}; if the file was a database, its first page is lost: replace it by the newest backup, and agents send the events in their spools again; or choose another file with `database`", path.display())]
    Unrecognised {
        /// The configured file.
        path: PathBuf,
        /// SQLite's error.
        source: DatabaseError,
    },
    /// The file is of another kind.
    #[error("{} is {what} and not an aggregator's database; choose another file with `database`", path.display())]
    NotADatabase {
        /// The configured file.
        path: PathBuf,
        /// Kind of the file.
        what: &'static str,
    },
    /// The database cannot be locked. Usually another process holds the lock.
    #[error("cannot start the aggregator: {0}")]
    Lock(#[from] LockError),
    /// The write-ahead log of another database lies beside the file.
    #[error(transparent)]
    ForeignLog(#[from] ForeignLog),
    /// The database was written by a newer version.
    #[error("the database {} was written by a newer version (its schema is {found}; this program supports schemas up to {supported}); update this program or choose another file with `database`", path.display())]
    NewerSchema {
        /// The configured file.
        path: PathBuf,
        /// Schema in the file.
        found: i64,
        /// Newest schema that this program supports.
        supported: i64,
    },
    /// The schema cannot be brought up to date.
    #[error("cannot bring the schema of the database {} up to date: {source}; keep the file, and restore a backup or choose another file with `database`", path.display())]
    Migrate {
        /// The configured file.
        path: PathBuf,
        /// The failed step.
        source: DatabaseError,
    },
}

impl OpenError {
    /// Creates the error for a database folder that cannot be created.
    pub fn folder_not_created(database: &Path, error: std::io::Error) -> Self {
        Self::Open { path: database.to_owned(), source: DatabaseError::new(error) }
    }

    /// Creates the error for a database that SQLite could not open or read.
    pub(crate) fn cannot_open(path: &Path, source: sqlx::Error) -> Self {
        let (path, is_partial_damage, is_damage) =
            (path.to_owned(), is_partial_damage(&source), is_damage(&source));
        let source = DatabaseError::new(source);
        match (is_partial_damage, is_damage) {
            // `with_repairability` sets `is_repairable` according to the contents of the file.
            (true, _) => Self::Damaged { path, source, is_repairable: true },
            // Any other damage means that the file is not a database.
            (false, true) => Self::Unrecognised { path, source },
            (false, false) => Self::Open { path, source },
        }
    }

    /// Sets `is_repairable` of a `Damaged` error according to the contents of the file.
    pub(crate) fn with_repairability(mut self, file: &Arc<File>) -> Self {
        if let Self::Damaged { is_repairable, .. } = &mut self {
            *is_repairable = has_table_list(Arc::clone(file));
        }
        self
    }
}

/// Reason why a query has no result, or a change was not made.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// SQLite reported an error.
    #[error("cannot read {what} from the database: {source}")]
    Database {
        /// Data that was requested.
        what: &'static str,
        /// SQLite's error.
        source: DatabaseError,
    },
    /// The database is damaged.
    #[error("cannot read or write {what}: {damage}")]
    Damaged {
        /// Data that was requested.
        what: &'static str,
        /// Description of the damage and of what to do.
        damage: String,
    },
    /// SQLite refused a change, or the task that writes has ended.
    #[error("cannot write {what} to the database: {source}; see the aggregator's log")]
    Write {
        /// Data that was to be written.
        what: &'static str,
        /// SQLite's error.
        source: DatabaseError,
    },
    /// The query took longer than the time limit of a statement.
    #[error(
        "cannot read {what} from the database: the query took longer than the {} s of [aggregator] question_limit_ms and was stopped; request less data, or raise the limit",
        limit.as_secs_f64()
    )]
    TooLong {
        /// Data that was requested.
        what: &'static str,
        /// The time limit of a statement.
        limit: Duration,
    },
    /// No connection became free within the time limit.
    #[error(
        "cannot read {what} from the database: all connections are busy; try again, or raise [aggregator] readers"
    )]
    Busy {
        /// Data that was requested.
        what: &'static str,
    },
    /// The database is closed now.
    #[error("cannot read {what}: the database is closed; /readyz gives the reason")]
    Closed {
        /// Data that was requested.
        what: &'static str,
    },
    /// The database holds a value that this version cannot have written.
    #[error("invalid {what} in the database: {detail}")]
    Corrupt {
        /// Data that was requested.
        what: &'static str,
        /// Description of the invalid value.
        detail: String,
    },
}

impl StoreError {
    /// Creates the error for a pin that is requested after the writing task has ended. A pin keeps a run from deletion.
    pub fn pin_without_writer() -> Self {
        Self::pin_failed(DatabaseError::new(sqlx::Error::WorkerCrashed))
    }

    /// Creates the error for a pin that is requested while the database is closed.
    pub fn pin_while_closed() -> Self {
        Self::pin_failed(DatabaseError::new(std::io::Error::other("the database is closed")))
    }

    /// Creates the error for a pin that cannot be written.
    pub(crate) fn pin_failed(source: DatabaseError) -> Self {
        Self::Write { what: "the pin of a run", source }
    }
}
