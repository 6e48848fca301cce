//! The only writing connection: it stores many batches in one transaction and returns the streams' new marks.
//!
//! The mark of a stream is the number up to which its batches are stored. A batch and the new mark are committed
//! together, and a batch at or below the mark is acknowledged but not stored. So each batch is stored exactly once. The
//! tables of an iteration's tree have no foreign keys: SQLite would check each node, and no check is needed, because
//! one writer owns the tables.

mod clock;
mod connections;
mod counters;
mod ends;
mod entities;
mod file;
mod foreign_reports;
mod names;
mod prepared;
mod quarantine;
mod records;
mod repeated_iterations;
mod rows;
mod secrets;
mod streams;
mod transaction;
mod work;

use std::collections::HashMap;
use std::path::PathBuf;

use peernet_clock::{Stamp, WallTime};
use peernet_logger::{HostId, RunId};
use peernet_stream::{BatchHead, HighWaterMark, HostSecret, StreamId};
use sqlx::{Connection, SqliteConnection};

pub use self::connections::ConnectionSample;
pub(crate) use self::entities::{UNKNOWN, read_host_counts, read_newest_runs, read_runs_without_start};
use self::file::DatabaseFile;
pub use self::file::{CommitError, FormerFiles};
use self::names::Names;
use self::prepared::PreparedBatch;
pub(crate) use self::secrets::read_host_secrets;
pub use self::streams::Streams;
use self::transaction::Staging;
pub(crate) use self::work::Refusal;
pub use self::work::{Introduction, LiveRunDescription, UnstorableBatch, Work};
use super::foreign_log::assign_id;
use super::limits::BUSY_TIMEOUT;
use super::retention::{self, Retention, StepResult};
use crate::database_error::DatabaseError;
use crate::error::StoreError;
pub use crate::incidents::PendingIncidents;
use crate::integrity::Integrity;
use crate::raw_transaction;
use crate::retention_config::RetentionConfig;
use crate::storage_clock::StorageClock;
use crate::stored::StoredCounts;

/// Copies the whole write-ahead log into the database file and empties the log, unless a reader is active.
const CHECKPOINT_AND_TRUNCATE: &str = "PRAGMA wal_checkpoint(TRUNCATE)";

/// Result of a transaction.
#[derive(Debug, Default)]
pub struct CommitResult {
    /// New marks: all batches of a stream up to the mark's number are stored.
    pub marks: HashMap<StreamId, HighWaterMark>,
    /// Totals of each host whose counters changed, and the time of the newest event that was stored for the host, on the
    /// host's clock.
    pub hosts: HashMap<HostId, (StoredCounts, Option<WallTime>)>,
    /// Numbers of runs that were created or read since the last commit.
    pub runs: Vec<(HostId, RunId, i64)>,
    /// Runs that were created without a start event.
    pub runs_without_start: Vec<(HostId, RunId)>,
    /// Number of nodes stored.
    pub nodes: u64,
    /// Secrets that [`Work::Secret`] requested, as stored now; `None` for a host without a stored secret.
    pub secrets: Vec<(HostId, Option<HostSecret>)>,
    /// Quarantined batches with the reason.
    pub quarantined: Vec<(BatchHead, String)>,
}

/// Owner of the writing connection.
///
/// The connection is never replaced. After an error that may come from the connection, the whole writer is replaced,
/// together with all its caches of the database.
#[derive(Debug)]
pub struct Writer {
    file: DatabaseFile,
    connection: SqliteConnection,
    staging: Staging,
    retention: Retention,
    storage_clock: StorageClock,
    /// The aggregator's wall clock at the last commit before this writer. `None` after it was compared with the current
    /// time.
    last_wall: Option<WallTime>,
    /// State of the streams as committed.
    streams: Streams,
    /// Results of the parts of `work` that were committed before a later part failed. The next call that succeeds
    /// returns these results.
    unreturned_result: CommitResult,
}

impl Writer {
    /// Creates a writer over an open connection and reads the state of the streams.
    pub async fn new(
        path: PathBuf,
        mut connection: SqliteConnection,
        retention: RetentionConfig,
    ) -> Result<Self, sqlx::Error> {
        let streams = Streams::load(&mut connection).await?;
        let names = Names::load(&mut connection).await?;
        let last_wall = crate::storage_clock::wall_at_last_commit(&mut connection).await?;
        Ok(Self {
            file: DatabaseFile::open(path)?,
            connection,
            staging: Staging::new(names),
            retention: Retention::new(retention),
            storage_clock: StorageClock::default(),
            last_wall,
            streams,
            unreturned_result: CommitResult::default(),
        })
    }

    /// Closes the connection. Returns the identities of the closed files.
    pub async fn close(mut self) -> (FormerFiles, Result<(), DatabaseError>) {
        self.retention.finish();
        if self.file.check().is_err() {
            // SQLite leaves the write-ahead log of a moved file behind, and would apply it to any file that takes the
            // place of the moved file. The log is therefore checkpointed now, through the open descriptors, so that the
            // moved file is complete without it.
            if let Err(error) = sqlx::query(CHECKPOINT_AND_TRUNCATE).execute(&mut self.connection).await {
                tracing::warn!(%error, log = %self.file.log_path().display(), "cannot checkpoint the write-ahead log into the database that was moved");
            }
        }
        let closed = self.connection.close().await.map_err(DatabaseError::new);
        (FormerFiles::new(self.file), closed)
    }

    /// Returns the current marks of the streams, and the last stream that each host used before this writer was created.
    pub fn streams(&self) -> &Streams {
        &self.streams
    }

    /// Stores all of `work`: in one transaction if the database accepts every batch, otherwise in several. A batch that
    /// cannot be stored is quarantined. If a batch repeats iterations that are already stored, its other iterations are
    /// stored.
    ///
    /// # Errors
    /// When the database cannot store anything now. The same work may be committed again: with this writer if the error
    /// [leaves the connection usable](CommitError::leaves_connection_usable), otherwise with a new writer. Also when
    /// the file or its log is no longer at its path; the work then does not count as stored.
    pub async fn commit(&mut self, work: &[Work], now: Stamp) -> Result<CommitResult, CommitError> {
        self.check_file()?;
        // The parts of `work` that are still to be stored. A part with an invalid batch is halved until the batch is
        // alone in its part.
        let mut parts = vec![work];
        while let Some(part) = parts.pop() {
            // `None`: the batches are stored, not quarantined.
            let committed = match self.attempt(part, now, None).await {
                Ok(committed) => committed,
                Err(Refusal::Database(error)) => {
                    return Err(self.file.commit_error(DatabaseError::new(error)));
                }
                Err(Refusal::Batch(_)) if part.len() > 1 => {
                    let (first, second) = part.split_at(part.len() / 2);
                    // `pop` takes the last element next, so the parts are stored in the order of their batches.
                    parts.extend([second, first]);
                    continue;
                }
                Err(Refusal::Batch(reason)) => self.store_refused_part(part, now, reason).await?,
            };
            self.unreturned_result.merge(committed);
        }
        // The file may have been moved while the transactions ran. Their data then counts as not stored.
        self.check_file()?;
        Ok(std::mem::take(&mut self.unreturned_result))
    }

    /// Pins a run, so that retention keeps its data, or unpins the run. Returns whether the run exists.
    ///
    /// # Errors
    /// When the database is damaged or cannot be written.
    pub async fn pin(&mut self, run: i64, pinned: bool, integrity: &Integrity) -> Result<bool, StoreError> {
        // Nothing is written to a damaged database.
        if let Some(damage) = integrity.damage_message() {
            return Err(StoreError::Damaged { what: "the pin of a run", damage });
        }
        let result = retention::pin(&mut self.connection, run, pinned).await;
        let result = self.roll_back_on_error(result).await.map_err(DatabaseError::new);
        result.inspect_err(|error| integrity.record_if_damage(error)).map_err(StoreError::pin_failed)
    }

    /// Makes one step of retention, which deletes a small amount of old data. Returns whether more old data remains.
    pub async fn retain(&mut self, now: Stamp) -> Result<StepResult, DatabaseError> {
        let Self { connection, storage_clock, .. } = self;
        let result = self.retention.step(connection, storage_clock, now, retention::MAX_STEP_COST).await;
        self.roll_back_on_error(result).await.map_err(DatabaseError::new)
    }

    /// Checks the wall clock for steps. Stores the pending incidents of the aggregator together with the readings of
    /// the storage clock and the wall clock. Without pending incidents, stores the readings only if nothing was stored
    /// for a while.
    pub async fn store_clock_readings(
        &mut self,
        now: Stamp,
        incidents: &mut PendingIncidents,
    ) -> Result<(), DatabaseError> {
        if let Some(last_wall) = self.last_wall.take() {
            incidents.compare_with_last_commit(now, last_wall);
        }
        incidents.check_step(now);
        if incidents.is_empty() && !self.storage_clock.is_due(now.mono) {
            return Ok(());
        }
        let result = self.store_incidents_and_clocks(now, incidents).await;
        self.roll_back_on_error(result).await.map_err(DatabaseError::new)?;
        self.storage_clock.record_commit(now.mono);
        // The incidents are cleared only after the commit: if a transaction fails, the next one stores its incidents.
        incidents.clear();
        Ok(())
    }

    async fn store_incidents_and_clocks(
        &mut self,
        now: Stamp,
        incidents: &PendingIncidents,
    ) -> Result<(), sqlx::Error> {
        let connection = &mut self.connection;
        raw_transaction::begin(connection).await?;
        incidents.store(connection).await?;
        self.storage_clock.advance(connection, now).await?;
        raw_transaction::commit(connection).await
    }

    /// Stores statistics of connections. Samples of a link without stored clock samples are omitted.
    ///
    /// # Errors
    /// When the database cannot store anything now.
    pub async fn store_connections(&mut self, samples: &[ConnectionSample]) -> Result<(), DatabaseError> {
        let storing = async {
            raw_transaction::begin(&mut self.connection).await?;
            connections::store(&mut self.connection, samples).await?;
            raw_transaction::commit(&mut self.connection).await
        };
        let result = storing.await;
        self.roll_back_on_error(result).await.map_err(DatabaseError::new)
    }

    /// Checkpoints the write-ahead log and truncates it if its file has more bytes than `max_bytes`, unless a reader is
    /// active.
    ///
    /// SQLite writes the log from its start again only if no reader uses the log at the moment of a commit. One long
    /// reader, or many short readers that overlap, therefore make the log grow. Without further commits the log keeps
    /// its size.
    pub async fn limit_write_ahead_log(&mut self, max_bytes: u64) -> Result<(), CommitError> {
        let bytes = std::fs::metadata(self.file.log_path()).map_or(0, |log| log.len());
        if bytes <= max_bytes {
            return Ok(());
        }
        Ok(self.checkpoint().await.map_err(DatabaseError::new)?)
    }

    async fn checkpoint(&mut self) -> Result<(), sqlx::Error> {
        // Waiting for readers would delay the next commit. The checkpoint is tried again soon anyway.
        sqlx::query("PRAGMA busy_timeout = 0").execute(&mut self.connection).await?;
        let result = sqlx::query(CHECKPOINT_AND_TRUNCATE).execute(&mut self.connection).await;
        let restore_timeout = format!("PRAGMA busy_timeout = {}", BUSY_TIMEOUT.as_millis());
        sqlx::raw_sql(sqlx::AssertSqlSafe(restore_timeout)).execute(&mut self.connection).await?;
        result.map(drop)
    }

    /// Makes a write transaction that changes no data, to check that the database can be written.
    pub async fn write_nothing(&mut self) -> Result<(), DatabaseError> {
        // `assign_id` writes page 1 even if the file has an id. So it fails if the database cannot be written.
        assign_id(&mut self.connection).await.map_err(DatabaseError::new)
    }

    /// Checks that the paths of the database and of its log still name the open files.
    ///
    /// # Errors
    /// When a path names another file or no file.
    pub fn check_file(&self) -> Result<(), CommitError> {
        self.file.check()
    }

    /// Locks the database, as another program can do that has opened the file.
    #[cfg(test)]
    pub async fn lock(&mut self) {
        sqlx::query("BEGIN EXCLUSIVE").execute(&mut self.connection).await.expect("locks");
    }

    /// Limits the size of the file, as a full disk would.
    #[cfg(test)]
    pub async fn limit_pages(&mut self, pages: u32) {
        let limit = format!("PRAGMA max_page_count = {pages}");
        sqlx::raw_sql(sqlx::AssertSqlSafe(limit)).execute(&mut self.connection).await.expect("limits");
    }

    /// Handles a part with a single piece of work that was refused because of `reason`. If some iterations of a refused
    /// batch are already stored, its other iterations are stored. Otherwise the batch is quarantined. For missing
    /// batches, the mark advances past them and no gap is stored. A message, such as a hello, is dropped.
    async fn store_refused_part(
        &mut self,
        part: &[Work],
        now: Stamp,
        mut reason: String,
    ) -> Result<CommitResult, CommitError> {
        if let [Work::Batch(batch)] = part {
            let repeated =
                repeated_iterations::find(&mut self.connection, batch).await.map_err(DatabaseError::new)?;
            if !repeated.is_empty()
                && let Ok(remaining_batch) =
                    PreparedBatch::without_iterations(batch.head, batch.body.clone(), &repeated)
            {
                match self.attempt(&[Work::Batch(Box::new(remaining_batch))], now, None).await {
                    Ok(committed) => {
                        let (host, number, left_out) = (batch.head.host, batch.head.number, repeated.len());
                        tracing::warn!(
                            %host, number, left_out,
                            "iterations that are already stored arrived in another batch and were skipped: two copies of \
                             one spool may be in use"
                        );
                        return Ok(committed);
                    }
                    Err(Refusal::Database(error)) => {
                        return Err(self.file.commit_error(DatabaseError::new(error)));
                    }
                    Err(Refusal::Batch(other_reason)) => reason = other_reason,
                }
            }
        }
        match self.attempt(part, now, Some(&reason)).await {
            Ok(committed) => Ok(committed),
            Err(Refusal::Database(error)) => Err(self.file.commit_error(DatabaseError::new(error))),
            // The batch could not be quarantined either. The refusal is returned as an error of the database, so that
            // the batch is not lost but tried again.
            Err(Refusal::Batch(reason)) => Err(DatabaseError::new(sqlx::Error::Protocol(reason)).into()),
        }
    }

    /// Stores `work` in one transaction. If `quarantine_reason` is given, the batches are quarantined for that reason.
    async fn attempt(
        &mut self,
        work: &[Work],
        now: Stamp,
        quarantine_reason: Option<&str>,
    ) -> Result<CommitResult, Refusal> {
        let result = {
            let Self { staging, connection, streams, storage_clock, .. } = self;
            staging.run(connection, work, &streams.marks, (storage_clock, now), quarantine_reason).await
        };
        match result {
            Ok(committed) => {
                self.storage_clock.record_commit(now.mono);
                self.streams.marks.extend(&committed.marks);
                Ok(committed)
            }
            Err(refusal) => {
                self.staging.forget();
                match (self.roll_back().await, refusal) {
                    // A failed roll-back is an error of the database. The batch is not quarantined because of it.
                    (Err(error), Refusal::Batch(_)) => Err(error.into()),
                    (_, refusal) => Err(refusal),
                }
            }
        }
    }

    /// Rolls back a transaction that a failed statement may have left open.
    async fn roll_back_on_error<T>(&mut self, result: Result<T, sqlx::Error>) -> Result<T, sqlx::Error> {
        if result.is_err() {
            self.roll_back().await?;
        }
        result
    }

    /// Rolls back an unfinished transaction and reads the names again, because names that the transaction added do not
    /// exist any more.
    async fn roll_back(&mut self) -> Result<(), sqlx::Error> {
        raw_transaction::roll_back(&mut self.connection).await?;
        self.staging.names = Names::load(&mut self.connection).await?;
        Ok(())
    }
}

impl CommitResult {
    fn merge(&mut self, other: Self) {
        self.marks.extend(other.marks);
        self.hosts.extend(other.hosts);
        self.runs.extend(other.runs);
        self.runs_without_start.extend(other.runs_without_start);
        self.nodes += other.nodes;
        self.secrets.extend(other.secrets);
        self.quarantined.extend(other.quarantined);
    }
}
