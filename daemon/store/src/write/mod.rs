//! The one writing connection: batches in, one transaction for many of them, marks out.

mod again;
mod aside;
mod clock;
mod connections;
mod counters;
mod ends;
mod entities;
mod file;
mod names;
mod prepared;
mod records;
mod rows;
mod secrets;
mod streams;
mod transaction;
mod trespasses;
mod work;

use std::collections::HashMap;
use std::path::PathBuf;

use peernet_clock::{Stamp, WallTime};
use peernet_logger::{HostId, RunId};
use peernet_stream::{BatchHead, HostSecret, Mark, StreamId};
use sqlx::{Connection, SqliteConnection};

pub use self::connections::ConnectionSample;
pub(crate) use self::entities::{UNKNOWN, newest_runs, stored_hosts, unknown_runs};
use self::file::DatabaseFile;
pub use self::file::{CommitError, FormerFiles};
use self::names::Names;
use self::prepared::Prepared;
pub(crate) use self::secrets::known_hosts;
pub use self::streams::Streams;
use self::transaction::Staging;
pub(crate) use self::work::Refusal;
pub use self::work::{Aside, Introduction, RunName, Work};
use super::foreign_log::mark;
use super::limits::BUSY;
use super::retention::{self, Retention, Step};
use crate::database_error::DatabaseError;
use crate::error::StoreError;
pub use crate::incidents::PendingIncidents;
use crate::integrity::Integrity;
use crate::raw_transaction;
use crate::retention_config::RetentionConfig;
use crate::storage_clock::StorageClock;
use crate::stored::Stored;

/// Carries the whole log over into the file and empties it, unless somebody reads.
const CARRY_OVER_ALL: &str = "PRAGMA wal_checkpoint(TRUNCATE)";

/// What a transaction stored.
#[derive(Debug, Default)]
pub struct Committed {
    /// New marks: all batches of the stream up to the number are stored.
    pub marks: HashMap<StreamId, Mark>,
    /// What the database now holds of each host concerned, and the newest moment it holds, on the host's clock.
    pub hosts: HashMap<HostId, (Stored, Option<WallTime>)>,
    /// Numbers of runs that were met for the first time.
    pub runs: Vec<(HostId, RunId, i64)>,
    /// Runs of which only iterations came.
    pub unknown: Vec<(HostId, RunId)>,
    /// Nodes stored.
    pub nodes: u64,
    /// Secrets that were read again, as they stand in the file.
    pub secrets: Vec<(HostId, Option<HostSecret>)>,
    /// Batches that were put aside, and why.
    pub quarantined: Vec<(BatchHead, String)>,
}

/// Owns the writing connection. It is never made anew: after an error that may be the connection's own the whole writer
/// is replaced, and with it all that memory holds of the database.
#[derive(Debug)]
pub struct Writer {
    file: DatabaseFile,
    connection: SqliteConnection,
    staging: Staging,
    retention: Retention,
    storage_clock: StorageClock,
    /// The aggregator's wall clock when something was last stored before this writer, until it is compared.
    last_wall: Option<WallTime>,
    /// As committed.
    streams: Streams,
    /// What a part of a group committed before another part failed: told when the group is handed in again.
    untold: Committed,
}

impl Writer {
    /// A writer over an open connection, and what is stored of each stream.
    pub async fn new(
        path: PathBuf,
        mut connection: SqliteConnection,
        keep: RetentionConfig,
    ) -> Result<Self, sqlx::Error> {
        let streams = Streams::load(&mut connection).await?;
        let names = Names::load(&mut connection).await?;
        let last_wall = crate::storage_clock::last_wall(&mut connection).await?;
        Ok(Self {
            file: DatabaseFile::of(path)?,
            connection,
            staging: Staging::new(names),
            retention: Retention::new(keep),
            storage_clock: StorageClock::default(),
            last_wall,
            streams,
            untold: Committed::default(),
        })
    }

    /// Closes the connection. Returns which files it was to.
    pub async fn close(mut self) -> (FormerFiles, Result<(), DatabaseError>) {
        self.retention.end();
        if self.file.check().is_err() {
            // SQLite leaves the log of a file that was moved where it is, and would apply it to whatever is put in
            // that file's place. Carried over now, through the descriptors, each file is whole by itself.
            if let Err(error) = sqlx::query(CARRY_OVER_ALL).execute(&mut self.connection).await {
                tracing::warn!(%error, log = %self.file.log_path().display(), "cannot carry the log over into the database that was moved");
            }
        }
        let closed = self.connection.close().await.map_err(DatabaseError::new);
        (FormerFiles::new(self.file), closed)
    }

    /// What is stored of each stream; of each host its last stream, as it was at the start.
    pub fn streams(&self) -> &Streams {
        &self.streams
    }

    /// Stores all of `work` in one transaction. A batch that cannot be stored is put aside, and only it; of one that
    /// brings iterations again the others are stored.
    ///
    /// # Errors
    /// When the database cannot store anything now: the same work may be handed in again if the error
    /// [leaves the connection usable](CommitError::leaves_connection_usable), and else to a new writer. Or when its file
    /// or its log is no longer where it was: nothing of it counts as stored then.
    pub async fn commit(&mut self, work: &[Work], now: Stamp) -> Result<Committed, CommitError> {
        self.check_file()?;
        // The group, or what is left of it: halved around a bad batch until that one is alone.
        let mut parts = vec![work];
        while let Some(part) = parts.pop() {
            let committed = match self.attempt(part, now, None).await {
                Ok(committed) => committed,
                Err(Refusal::Database(error)) => return Err(DatabaseError::new(error).into()),
                Err(Refusal::Batch(_)) if part.len() > 1 => {
                    let (first, second) = part.split_at(part.len() / 2);
                    parts.extend([second, first]);
                    continue;
                }
                Err(Refusal::Batch(reason)) => self.alone(part, now, reason).await?,
            };
            self.untold.merge(committed);
        }
        self.file.remember_log();
        self.check_file()?;
        Ok(std::mem::take(&mut self.untold))
    }

    /// Keeps a run whatever its age, or no longer. Returns whether there is such a run.
    ///
    /// # Errors
    /// When the database refuses, or is damaged.
    pub async fn pin(&mut self, run: i64, pinned: bool, integrity: &Integrity) -> Result<bool, StoreError> {
        if let Some(refusal) = integrity.refusal() {
            return Err(StoreError::Damaged { what: "whether a run is kept", refusal });
        }
        let result = retention::pin(&mut self.connection, run, pinned).await;
        let result = self.rolled_back(result).await.map_err(DatabaseError::new);
        result.inspect_err(|error| integrity.note(error)).map_err(StoreError::pinning)
    }

    /// Deletes a little of what is old, if anything is; whether there is more.
    pub async fn retain(&mut self, now: Stamp) -> Result<Step, DatabaseError> {
        let Self { connection, storage_clock, .. } = self;
        let result = self.retention.step(connection, storage_clock, now, retention::ROWS).await;
        self.rolled_back(result).await.map_err(DatabaseError::new)
    }

    /// Looks at the wall clock, stores incidents of the aggregator that wait, and the storage clock where nothing else was
    /// stored for a while.
    pub async fn keep_clocks(
        &mut self,
        now: Stamp,
        incidents: &mut PendingIncidents,
    ) -> Result<(), DatabaseError> {
        if let Some(last_wall) = self.last_wall.take() {
            incidents.compare(now, last_wall);
        }
        incidents.look(now);
        if incidents.is_empty() && !self.storage_clock.is_due(now.mono) {
            return Ok(());
        }
        let result = self.store_clocks(now, incidents).await;
        self.rolled_back(result).await.map_err(DatabaseError::new)?;
        self.storage_clock.committed(now.mono);
        incidents.clear();
        self.file.remember_log();
        Ok(())
    }

    async fn store_clocks(&mut self, now: Stamp, incidents: &PendingIncidents) -> Result<(), sqlx::Error> {
        let connection = &mut self.connection;
        raw_transaction::begin(connection).await?;
        incidents.store(connection).await?;
        self.storage_clock.advance(connection, now).await?;
        raw_transaction::commit(connection).await
    }

    /// Stores statistics of connections; those of a link of which nothing else is stored are left out.
    ///
    /// # Errors
    /// When the database cannot store anything now.
    pub async fn store_connections(&mut self, samples: &[ConnectionSample]) -> Result<(), DatabaseError> {
        let stored = async {
            raw_transaction::begin(&mut self.connection).await?;
            connections::store(&mut self.connection, samples).await?;
            raw_transaction::commit(&mut self.connection).await
        };
        let result = stored.await;
        self.rolled_back(result).await.map_err(DatabaseError::new)?;
        self.file.remember_log();
        Ok(())
    }

    /// Carries the log over and empties it when its file has more bytes than this, unless somebody reads just now.
    ///
    /// SQLite begins the log again only when no reader is using it at the moment of a commit: one long reader, or many
    /// short ones that overlap, let it grow, and without further commits it stays as it is.
    pub async fn bound_log(&mut self, most_bytes: u64) -> Result<(), CommitError> {
        let bytes = std::fs::metadata(self.file.log_path()).map_or(0, |log| log.len());
        if bytes <= most_bytes {
            return Ok(());
        }
        Ok(self.carry_over().await.map_err(DatabaseError::new)?)
    }

    async fn carry_over(&mut self) -> Result<(), sqlx::Error> {
        // Tried again soon: what waits to be stored does not wait for readers.
        sqlx::query("PRAGMA busy_timeout = 0").execute(&mut self.connection).await?;
        let carried_over = sqlx::query(CARRY_OVER_ALL).execute(&mut self.connection).await;
        let wait = format!("PRAGMA busy_timeout = {}", BUSY.as_millis());
        sqlx::raw_sql(sqlx::AssertSqlSafe(wait)).execute(&mut self.connection).await?;
        carried_over.map(drop)
    }

    /// Writes something that changes nothing, to see that writing works.
    pub async fn write_nothing(&mut self) -> Result<(), DatabaseError> {
        mark(&mut self.connection).await.map_err(DatabaseError::new)?;
        self.file.remember_log();
        Ok(())
    }

    /// Whether the paths of the database and of its log still name the files that are open.
    ///
    /// # Errors
    /// When they do not.
    pub fn check_file(&self) -> Result<(), CommitError> {
        self.file.check()
    }

    /// Keeps others from writing, as a program that opened the file might.
    #[cfg(test)]
    pub async fn lock(&mut self) {
        sqlx::query("BEGIN EXCLUSIVE").execute(&mut self.connection).await.expect("locks");
    }

    /// Lets the file grow to so many pages and no further, as a full disk would.
    #[cfg(test)]
    pub async fn limit_pages(&mut self, pages: u32) {
        let limit = format!("PRAGMA max_page_count = {pages}");
        sqlx::raw_sql(sqlx::AssertSqlSafe(limit)).execute(&mut self.connection).await.expect("limits");
    }

    /// Stores one batch that was refused: without the iterations that are stored already, or else aside.
    async fn alone(
        &mut self,
        part: &[Work],
        now: Stamp,
        mut reason: String,
    ) -> Result<Committed, CommitError> {
        if let [Work::Batch(batch)] = part {
            let stored = again::stored(&mut self.connection, batch).await.map_err(DatabaseError::new)?;
            if !stored.is_empty()
                && let Ok(rest) = Prepared::without(batch.head, batch.body.clone(), &stored)
            {
                match self.attempt(&[Work::Batch(Box::new(rest))], now, None).await {
                    Ok(committed) => {
                        let (host, number, left_out) = (batch.head.host, batch.head.number, stored.len());
                        tracing::warn!(
                            %host, number, left_out,
                            "iterations that are stored already came in another batch and were left out: perhaps two \
                             copies of one spool are in use"
                        );
                        return Ok(committed);
                    }
                    Err(Refusal::Database(error)) => return Err(DatabaseError::new(error).into()),
                    Err(Refusal::Batch(also)) => reason = also,
                }
            }
        }
        match self.attempt(part, now, Some(&reason)).await {
            Ok(committed) => Ok(committed),
            Err(Refusal::Database(error)) => Err(DatabaseError::new(error).into()),
            Err(Refusal::Batch(reason)) => Err(DatabaseError::new(sqlx::Error::Protocol(reason)).into()),
        }
    }

    /// One transaction; with `aside` the batches go to the quarantine for that reason.
    async fn attempt(
        &mut self,
        work: &[Work],
        now: Stamp,
        aside: Option<&str>,
    ) -> Result<Committed, Refusal> {
        let result = {
            let Self { staging, connection, streams, storage_clock, .. } = self;
            staging.run(connection, work, &streams.marks, (storage_clock, now), aside).await
        };
        match result {
            Ok(committed) => {
                self.storage_clock.committed(now.mono);
                self.streams.marks.extend(&committed.marks);
                Ok(committed)
            }
            Err(refusal) => {
                self.staging.forget();
                match (self.roll_back().await, refusal) {
                    (Err(error), Refusal::Batch(_)) => Err(error.into()),
                    (_, refusal) => Err(refusal),
                }
            }
        }
    }

    /// Undoes what a failed statement may have left open.
    async fn rolled_back<T>(&mut self, result: Result<T, sqlx::Error>) -> Result<T, sqlx::Error> {
        if result.is_err() {
            self.roll_back().await?;
        }
        result
    }

    /// Undoes an unfinished transaction, also in memory: the names that it added are gone.
    async fn roll_back(&mut self) -> Result<(), sqlx::Error> {
        raw_transaction::roll_back(&mut self.connection).await?;
        self.staging.names = Names::load(&mut self.connection).await?;
        Ok(())
    }
}

impl Committed {
    fn merge(&mut self, other: Self) {
        self.marks.extend(other.marks);
        self.hosts.extend(other.hosts);
        self.runs.extend(other.runs);
        self.unknown.extend(other.unknown);
        self.nodes += other.nodes;
        self.secrets.extend(other.secrets);
        self.quarantined.extend(other.quarantined);
    }
}
