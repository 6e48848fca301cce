//! Opening of the database for writing, at the start and after the file was moved, replaced or unmounted.
//!
//! Reopening assumes nothing about the contents of the file. Reopening therefore works in the same way for an open file
//! that can no longer be written, for example because its file system became read-only, and for a file that was moved,
//! replaced or unmounted. Reopening takes the same steps as the start, but never accepts an empty or missing file.

use std::path::{Path, PathBuf};

use peernet_logger::{HostId, RunId};
use peernet_stream::HostSecret;

use super::database;
use super::foreign_log::{ForeignLog, refuse_foreign_log};
use super::integrity::{Integrity, IntegrityCheck};
use super::lock::{DatabaseLock, LockError};
use super::write::{
    CommitError, FormerFiles, Streams, Writer, read_host_counts, read_host_secrets, read_newest_runs,
    read_runs_without_start,
};
use crate::database_error::DatabaseError;
use crate::error::OpenError;
use crate::retention_config::RetentionConfig;
use crate::stored::StoredCounts;

/// Number of newest runs that are read at the opening, because agents may still be executing them.
const MAX_RUNS: u32 = 1_000;
/// Number of hosts whose stored counts are read at the opening.
const MAX_HOSTS: u32 = 4_096;

/// A database that this process may write.
#[derive(Debug)]
pub struct OpenDatabase {
    /// The only connection that writes.
    pub writer: Writer,
    check: IntegrityCheck,
    /// Lock of the file, released after the connection is closed ([`DatabaseLock`] gives the reason).
    lock: DatabaseLock,
}

/// Contents of a database at its opening, from which ingest and the live state start.
#[derive(Debug)]
pub struct StoredState {
    /// The stored streams with their marks.
    pub streams: Streams,
    /// The newest runs with their numbers.
    pub runs: Vec<(HostId, RunId, i64)>,
    /// Runs that have not ended and have stored iterations but no stored start. Their pipelines are therefore unknown.
    pub runs_without_start: Vec<(HostId, RunId)>,
    /// Counts of each host's stored data.
    pub hosts: Vec<(HostId, StoredCounts)>,
    /// All stored hosts in the order of their first contact, with their secrets.
    pub host_secrets: Vec<(HostId, Option<HostSecret>)>,
}

/// Reason why a database that was in use could not be opened again.
#[derive(Debug, thiserror::Error)]
pub enum ReopenError {
    /// The path names no file.
    #[error(transparent)]
    Missing(CommitError),
    /// The file at the path is empty.
    #[error("the database file {} is empty; put the right file there, or restart the aggregator to create a new database in it", .0.display())]
    Empty(PathBuf),
    /// The write-ahead log at the path belongs to another database, which was at this path before. SQLite would apply
    /// this log to the new file.
    #[error(transparent)]
    ForeignLog(ForeignLog),
    /// Another process holds the lock, or the file cannot be opened for writing.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The database cannot be opened, for a reason that also prevents a start.
    #[error(transparent)]
    Start(#[from] OpenError),
}

impl OpenDatabase {
    /// Opens a database, creates it if it is missing, and brings its schema up to date.
    pub async fn open(
        path: &Path,
        retention: RetentionConfig,
        integrity: &Integrity,
    ) -> Result<(Self, StoredState), OpenError> {
        let lock = DatabaseLock::take(path)?;
        Self::open_locked(lock, path, retention, integrity).await
    }

    /// Opens the file that is now at the path of a database that was in use: the same file or another one.
    ///
    /// An empty file is refused: a new database in it would hide that the right file is missing.
    pub async fn reopen(
        path: &Path,
        retention: RetentionConfig,
        integrity: &Integrity,
        former: &FormerFiles,
    ) -> Result<(Self, StoredState), ReopenError> {
        let lock = match DatabaseLock::take_existing(path) {
            Err(LockError::Failed { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                return Err(ReopenError::Missing(CommitError::Moved(path.to_owned())));
            }
            taken => taken?,
        };
        let cannot_open = |error: std::io::Error| OpenError::Open {
            path: path.to_owned(),
            source: DatabaseError::new(error),
        };
        if std::fs::metadata(path).map_err(cannot_open)?.len() == 0 {
            return Err(ReopenError::Empty(path.to_owned()));
        }
        if let Some(log) = former.leftover_log() {
            return Err(ReopenError::ForeignLog(ForeignLog(log)));
        }
        let (mut database, state) = Self::open_locked(lock, path, retention, integrity).await?;
        // SQLite can open a file that cannot be written. This transaction shows whether the file can be written.
        if let Err(source) = database.writer.write_nothing().await {
            // A connection that is only dropped keeps the file open for some time. During this time the lock is held,
            // and the file system cannot be unmounted.
            let (_, closed) = database.close().await;
            if let Err(error) = closed {
                tracing::debug!(%error, database = %path.display(), "cannot close the database cleanly");
            }
            return Err(OpenError::Open { path: path.to_owned(), source }.into());
        }
        Ok((database, state))
    }

    /// Opens a database whose lock is held, and reads its state.
    async fn open_locked(
        lock: DatabaseLock,
        path: &Path,
        retention: RetentionConfig,
        integrity: &Integrity,
    ) -> Result<(Self, StoredState), OpenError> {
        let cannot_open = |source| OpenError::cannot_open(path, source);
        integrity.load_record().map_err(|error| cannot_open(error.into()))?;
        refuse_foreign_log(path, &lock.file())?;
        // Taking the lock created the file if it was missing. If the file was removed since then, it must not be
        // created again without a lock.
        let mut connection =
            database::open_existing(path).await.map_err(|error| error.with_repairability(&lock.file()))?;
        let runs = read_newest_runs(&mut connection, MAX_RUNS).await.map_err(cannot_open)?;
        let runs_without_start =
            read_runs_without_start(&mut connection, MAX_RUNS).await.map_err(cannot_open)?;
        let host_secrets = read_host_secrets(&mut connection).await.map_err(cannot_open)?;
        let hosts = read_host_counts(&mut connection, MAX_HOSTS).await.map_err(cannot_open)?;
        let writer = Writer::new(path.to_owned(), connection, retention).await.map_err(cannot_open)?;
        // Another file may have replaced the locked file before SQLite opened the path. SQLite would then write to a
        // file without a lock.
        if !lock.is_lock_of(path).map_err(|error| cannot_open(error.into()))? {
            let moved = CommitError::Moved(path.to_owned()).to_string();
            return Err(cannot_open(std::io::Error::other(moved).into()));
        }
        let state =
            StoredState { streams: writer.streams().clone(), runs, runs_without_start, hosts, host_secrets };
        let check = IntegrityCheck::start(integrity.clone(), lock.file());
        Ok((Self { writer, check, lock }, state))
    }

    /// Closes the connection and releases the lock. When the last connection to the file is closed, SQLite checkpoints
    /// the write-ahead log into the file and removes the log. Returns the identities of the database's files, which
    /// [`OpenDatabase::reopen`] takes.
    pub async fn close(self) -> (FormerFiles, Result<(), DatabaseError>) {
        let Self { writer, check, lock } = self;
        check.stop().await;
        let closed = writer.close().await;
        // This comes last, because closing this descriptor releases the locks that SQLite holds on the file.
        drop(lock);
        closed
    }
}
