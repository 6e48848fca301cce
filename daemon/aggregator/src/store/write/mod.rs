//! The one writing connection: batches in, one transaction for many of them, marks out.

mod again;
mod aside;
mod clock;
mod counters;
mod ends;
mod entities;
mod file;
mod insert;
mod names;
mod prepared;
mod records;
pub(crate) mod rollups;
mod rows;
mod streams;
mod transaction;
mod work;

use std::collections::HashMap;
use std::path::PathBuf;

use peernet_clock::WallTime;
use peernet_logger::stream::{BatchHead, Mark, StreamId};
use peernet_logger::{HostId, RunId};
use sqlx::{ConnectOptions, Connection, SqliteConnection};

pub(crate) use self::entities::{UNKNOWN, newest_runs, placement_word, stored_hosts, unknown_runs};
pub(crate) use self::file::CommitError;
use self::file::DatabaseFile;
use self::names::Names;
use self::prepared::Prepared;
pub(crate) use self::streams::Streams;
use self::transaction::Staging;
pub(crate) use self::work::{Aside, Introduction, Refusal, RunName, Work};
use super::database;
use super::retention::{self, Retention, Step};
use crate::config::RetentionConfig;
use crate::picture::Stored;

/// What a transaction stored.
#[derive(Debug, Default)]
pub(crate) struct Committed {
    /// New marks: all batches of the stream up to the number are stored.
    pub(crate) marks: HashMap<StreamId, Mark>,
    /// What the database now holds of each host concerned, and the newest moment it holds, on the host's clock.
    pub(crate) hosts: HashMap<HostId, (Stored, Option<WallTime>)>,
    /// Numbers of runs that were met for the first time.
    pub(crate) runs: Vec<(RunId, i64)>,
    /// Runs of which only iterations came.
    pub(crate) unknown: Vec<RunId>,
    /// Nodes stored.
    pub(crate) nodes: u64,
    /// Batches that were put aside, and why.
    pub(crate) quarantined: Vec<(BatchHead, String)>,
}

/// Owns the writing connection.
#[derive(Debug)]
pub(crate) struct Writer {
    file: DatabaseFile,
    /// `None` after it broke, until the next attempt.
    connection: Option<SqliteConnection>,
    staging: Staging,
    retention: Retention,
    /// As committed.
    streams: Streams,
    /// What was committed to a file that had been moved by then: told when it is back.
    untold: Committed,
}

impl Writer {
    /// A writer over an open connection, and what is stored of each stream.
    pub(crate) async fn new(
        path: PathBuf,
        mut connection: SqliteConnection,
        keep: RetentionConfig,
    ) -> Result<Self, sqlx::Error> {
        let streams = Streams::load(&mut connection).await?;
        let names = Names::load(&mut connection).await?;
        Ok(Self {
            file: DatabaseFile::of(path)?,
            connection: Some(connection),
            staging: Staging::new(names),
            retention: Retention::new(keep),
            streams,
            untold: Committed::default(),
        })
    }

    /// Closes the connection. When it is the last one to the file, SQLite carries its log over into it and removes it.
    pub(crate) async fn close(self) -> Result<(), sqlx::Error> {
        match self.connection {
            Some(connection) => connection.close().await,
            None => Ok(()),
        }
    }

    /// What is stored of each stream; of each host its last stream, as it was at the start.
    pub(crate) fn streams(&self) -> &Streams {
        &self.streams
    }

    /// Stores all of `work` in one transaction. A batch that cannot be stored is put aside, and only it; of one that
    /// brings iterations again the others are stored.
    ///
    /// # Errors
    /// When the database cannot store anything now; nothing has changed then. Or when its file is no longer where it
    /// was: what was committed meanwhile is told of when the file is back and the same work is handed in again. Or when
    /// its log is gone: nothing more is committed then.
    pub(crate) async fn commit(&mut self, work: &[Work], now: WallTime) -> Result<Committed, CommitError> {
        self.check_file()?;
        // The group, or what is left of it: halved around a bad batch until that one is alone.
        let mut parts = vec![work];
        while let Some(part) = parts.pop() {
            let committed = match self.attempt(part, now, None).await {
                Ok(committed) => committed,
                Err(Refusal::Database(error)) => return Err(error.into()),
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
    pub(crate) async fn pin(&mut self, run: i64, pinned: bool) -> Result<bool, sqlx::Error> {
        let mut connection = self.connection().await?;
        // A connection that failed is not used again.
        let known = retention::pin(&mut connection, run, pinned).await?;
        self.connection = Some(connection);
        Ok(known)
    }

    /// Deletes a little of what is old, if anything is; whether there is more.
    pub(crate) async fn retain(&mut self, now: WallTime) -> Result<Step, sqlx::Error> {
        let mut connection = self.connection().await?;
        let step = self.retention.step(&mut connection, now, retention::ROWS).await?;
        self.connection = Some(connection);
        Ok(step)
    }

    /// Whether the paths of the database and of its log still name the files that are open.
    ///
    /// # Errors
    /// When they do not.
    pub(crate) fn check_file(&self) -> Result<(), CommitError> {
        self.file.check()
    }

    /// Keeps others from writing, as a program that opened the file might.
    #[cfg(test)]
    pub(crate) async fn lock(&mut self) {
        let connection = self.connection.as_mut().expect("connected");
        sqlx::query("BEGIN EXCLUSIVE").execute(connection).await.expect("locks");
    }

    /// Lets the file grow to so many pages and no further, as a full disk would.
    #[cfg(test)]
    pub(crate) async fn limit_pages(&mut self, pages: u32) {
        let connection = self.connection.as_mut().expect("connected");
        let limit = format!("PRAGMA max_page_count = {pages}");
        sqlx::raw_sql(sqlx::AssertSqlSafe(limit)).execute(connection).await.expect("limits");
    }

    /// The connection, made anew when it broke.
    async fn connection(&mut self) -> Result<SqliteConnection, sqlx::Error> {
        match self.connection.take() {
            Some(connection) => Ok(connection),
            None => self.connect().await,
        }
    }

    /// Another connection in place of one that was closed: if that was the last, SQLite has removed the log with it.
    async fn connect(&mut self) -> Result<SqliteConnection, sqlx::Error> {
        self.file.forget_log();
        database::writing(self.file.path()).connect().await
    }

    /// Stores one batch that was refused: without the iterations that are stored already, or else aside.
    async fn alone(
        &mut self,
        part: &[Work],
        now: WallTime,
        mut reason: String,
    ) -> Result<Committed, CommitError> {
        if let [Work::Batch(batch)] = part {
            let mut connection = self.connection().await?;
            let stored = again::stored(&mut connection, batch).await?;
            self.connection = Some(connection);
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
                    Err(Refusal::Database(error)) => return Err(error.into()),
                    Err(Refusal::Batch(also)) => reason = also,
                }
            }
        }
        match self.attempt(part, now, Some(&reason)).await {
            Ok(committed) => Ok(committed),
            Err(Refusal::Database(error)) => Err(error.into()),
            Err(Refusal::Batch(reason)) => Err(sqlx::Error::Protocol(reason).into()),
        }
    }

    /// One transaction; with `aside` the batches go to the quarantine for that reason.
    async fn attempt(
        &mut self,
        work: &[Work],
        now: WallTime,
        aside: Option<&str>,
    ) -> Result<Committed, Refusal> {
        let mut connection = self.connection().await?;
        let result = self.staging.run(&mut connection, work, &self.streams.marks, now, aside).await;
        match result {
            Ok(committed) => {
                self.connection = Some(connection);
                self.streams.marks.extend(&committed.marks);
                Ok(committed)
            }
            Err(refusal) => {
                self.staging.forget();
                // A connection that cannot even roll back is replaced; the names are read again either way,
                // because those that the transaction added are gone.
                let restored = async {
                    sqlx::query("ROLLBACK").execute(&mut connection).await?;
                    Names::load(&mut connection).await
                };
                match restored.await {
                    Ok(names) => {
                        self.staging.names = names;
                        self.connection = Some(connection);
                    }
                    Err(_) => {
                        let _closed = connection.close().await;
                        let mut connection = self.connect().await?;
                        self.staging.names = Names::load(&mut connection).await?;
                        self.connection = Some(connection);
                    }
                }
                Err(refusal)
            }
        }
    }
}

impl Committed {
    fn merge(&mut self, other: Self) {
        self.marks.extend(other.marks);
        self.hosts.extend(other.hosts);
        self.runs.extend(other.runs);
        self.unknown.extend(other.unknown);
        self.nodes += other.nodes;
        self.quarantined.extend(other.quarantined);
    }
}
