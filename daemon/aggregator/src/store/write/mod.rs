//! The one writing connection: batches in, one transaction for many of them, marks out.

mod aside;
mod clock;
mod ends;
mod entities;
mod file;
mod insert;
mod iteration;
mod names;
mod records;
mod rollups;
mod rows;
mod work;

use std::collections::HashMap;
use std::path::PathBuf;

use peernet_clock::WallTime;
use peernet_logger::stream::codec::BatchHead;
use peernet_logger::stream::{Batch, Event, StreamId};
use peernet_logger::{HostId, RunId};
use sqlx::{ConnectOptions, Connection, SqliteConnection};

use self::clock::Links;
use self::ends::Ends;
use self::entities::Entities;
use self::entities::stream_marks;
pub(crate) use self::entities::{Mark, UNKNOWN, newest_runs, placement_word, stored_hosts, unknown_runs};
pub(crate) use self::file::CommitError;
use self::file::DatabaseFile;
use self::iteration::Staging;
use self::names::Names;
use self::rows::Inserts;
pub(crate) use self::work::{Refusal, RunName, Work};
use super::database;
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

/// What a transaction adds to the counters of a host.
#[derive(Debug, Default)]
struct HostCounts {
    id: i64,
    added: Stored,
    newest: Option<WallTime>,
}

/// Owns the writing connection.
#[derive(Debug)]
pub(crate) struct Writer {
    file: DatabaseFile,
    /// `None` after it broke, until the next attempt.
    connection: Option<SqliteConnection>,
    entities: Entities,
    staging: Staging,
    inserts: Inserts,
    /// Marks as committed.
    marks: HashMap<StreamId, Mark>,
    ends: Ends,
    links: Links,
    /// What was committed to a file that had been moved by then: told when it is back.
    untold: Committed,
}

impl Writer {
    /// A writer over an open connection, and what is stored of each stream.
    pub(crate) async fn new(path: PathBuf, mut connection: SqliteConnection) -> Result<Self, sqlx::Error> {
        let marks = stream_marks(&mut connection).await?;
        let names = Names::load(&mut connection).await?;
        Ok(Self {
            file: DatabaseFile::of(path)?,
            connection: Some(connection),
            entities: Entities::default(),
            staging: Staging { names, ..Staging::default() },
            inserts: Inserts::default(),
            marks,
            ends: Ends::default(),
            links: Links::default(),
            untold: Committed::default(),
        })
    }

    /// What is stored of each stream.
    pub(crate) fn marks(&self) -> &HashMap<StreamId, Mark> {
        &self.marks
    }

    /// Stores all of `work` in one transaction. A batch that cannot be stored is put aside, and only it.
    ///
    /// # Errors
    /// When the database cannot store anything now; nothing has changed then. Or when its file is no longer where it
    /// was: what was committed meanwhile is told of when the file is back and the same work is handed in again.
    pub(crate) async fn commit(&mut self, work: &[Work], now: WallTime) -> Result<Committed, CommitError> {
        self.check_file()?;
        let committed = match self.attempt(work, now, None).await {
            Ok(committed) => committed,
            Err(Refusal::Database(error)) => return Err(error.into()),
            Err(Refusal::Batch(_)) => self.one_by_one(work, now).await?,
        };
        self.untold.merge(committed);
        self.check_file()?;
        Ok(std::mem::take(&mut self.untold))
    }

    /// Whether the database's path still names the file that is open.
    ///
    /// # Errors
    /// When it does not.
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

    /// Finds the bad one: each in its own transaction.
    async fn one_by_one(&mut self, work: &[Work], now: WallTime) -> Result<Committed, sqlx::Error> {
        let mut all = Committed::default();
        for item in work {
            let item = std::slice::from_ref(item);
            let committed = match self.attempt(item, now, None).await {
                Ok(committed) => committed,
                Err(Refusal::Database(error)) => return Err(error),
                Err(Refusal::Batch(reason)) => match self.attempt(item, now, Some(&reason)).await {
                    Ok(committed) => committed,
                    Err(Refusal::Database(error)) => return Err(error),
                    Err(Refusal::Batch(reason)) => return Err(sqlx::Error::Protocol(reason)),
                },
            };
            all.merge(committed);
        }
        Ok(all)
    }

    /// One transaction; with `aside` the batches go to the quarantine for that reason.
    async fn attempt(
        &mut self,
        work: &[Work],
        now: WallTime,
        aside: Option<&str>,
    ) -> Result<Committed, Refusal> {
        let mut connection = match self.connection.take() {
            Some(connection) => connection,
            None => database::writing(self.file.path()).connect().await?,
        };
        let result = self.transact(&mut connection, work, now, aside).await;
        match result {
            Ok(committed) => {
                self.connection = Some(connection);
                self.marks.extend(&committed.marks);
                Ok(committed)
            }
            Err(refusal) => {
                self.staging.forget();
                self.entities.forget();
                self.ends.forget();
                self.links.forget();
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
                        let mut connection = database::writing(self.file.path()).connect().await?;
                        self.staging.names = Names::load(&mut connection).await?;
                        self.connection = Some(connection);
                    }
                }
                Err(refusal)
            }
        }
    }

    async fn transact(
        &mut self,
        connection: &mut SqliteConnection,
        work: &[Work],
        now: WallTime,
        aside: Option<&str>,
    ) -> Result<Committed, Refusal> {
        sqlx::query("BEGIN IMMEDIATE").execute(&mut *connection).await?;
        let mut committed = Committed::default();
        let mut hosts = HashMap::<HostId, HostCounts>::new();
        for item in work {
            let Some(head) = item.head() else {
                // Nothing of a greeting can be put aside: the batches that follow bring the host's row.
                match (item, aside) {
                    (Work::Hello { host, process }, None) => {
                        let id = self.entities.introduce(connection, host, now).await?;
                        self.ends.process(connection, id, *process).await?;
                        hosts.entry(host.id).or_default().id = id;
                    }
                    (Work::Goodbye(host), None) => {
                        let id = self.entities.host(connection, *host, now).await?;
                        self.ends.left(connection, id).await?;
                    }
                    (Work::Name(name), None) => self.entities.name_run(connection, name, now).await?,
                    _ => {}
                }
                continue;
            };
            let mark = committed.marks.get(&head.stream).or_else(|| self.marks.get(&head.stream)).copied();
            if let Some(mark) = mark.filter(|mark| head.number <= mark.stored) {
                // Came again before its acknowledgement: stored once.
                committed.marks.insert(head.stream, mark);
                continue;
            }
            let counts = hosts.entry(head.host).or_default();
            counts.id = self.entities.host(connection, head.host, now).await?;
            let reason = match (item, aside) {
                (Work::Batch(batch), None) => {
                    self.stage(connection, batch, counts, now).await?;
                    None
                }
                (Work::Unreadable { reason, .. }, None) => Some(reason.as_str()),
                (Work::Missing(missing), _) => {
                    records::missing(connection, counts.id, missing, now).await?;
                    counts.added.gaps += 1;
                    None
                }
                (_, aside) => aside,
            };
            if let Some(reason) = reason {
                records::quarantine(connection, counts.id, head, item, reason, now).await?;
                counts.added.quarantined += 1;
                let (gaps, missing) =
                    aside::gaps(connection, &mut self.entities, counts.id, item, reason, now).await?;
                counts.added.gaps += gaps;
                counts.added.missing = counts.added.missing.saturating_add(missing);
                committed.quarantined.push((head, reason.to_owned()));
            }
            records::mark(connection, counts.id, head, now).await?;
            committed.marks.insert(head.stream, Mark { host: head.host, stored: head.number });
        }
        committed.nodes = self.staging.rows.nodes.len() as u64;
        self.inserts.run(connection, &mut self.staging.rows).await?;
        self.staging.rollups.write(connection).await?;
        records::count_runs(connection, self.staging.runs.drain()).await?;
        self.ends.write(connection).await?;
        for (id, counts) in hosts {
            let stored = records::count_host(connection, counts.id, &counts.added, now).await?;
            committed.hosts.insert(id, (stored, counts.newest));
        }
        sqlx::query("COMMIT").execute(connection).await?;
        committed.runs = self.entities.take_met();
        committed.unknown = self.entities.take_unknown();
        Ok(committed)
    }

    async fn stage(
        &mut self,
        connection: &mut SqliteConnection,
        batch: &Batch,
        counts: &mut HostCounts,
        now: WallTime,
    ) -> Result<(), Refusal> {
        let host = counts.id;
        for event in &batch.events {
            let at = match event {
                Event::RunStarted(run) => {
                    let (known, pipeline) = self.entities.run_started(connection, host, run).await?;
                    self.ends.followed(pipeline, known.number);
                    run.started
                }
                Event::RunEnded(end) => {
                    self.entities.run_ended(connection, host, end).await?;
                    end.ended
                }
                Event::Iteration(iteration) => {
                    let started = iteration.tree.anchors().first().map_or(now, |edge| edge.wall);
                    let run = self.entities.run_of(connection, host, iteration.run, started).await?;
                    self.staging
                        .add(connection, &mut self.entities, (batch.host, run), iteration, now)
                        .await?;
                    counts.added.nodes += iteration.tree.nodes().len() as u64;
                    started
                }
                Event::Incident(incident) => {
                    records::incident(connection, &mut self.entities, host, incident, now).await?;
                    incident.at
                }
                Event::Gap(gap) => {
                    records::gap(connection, &mut self.entities, host, gap).await?;
                    counts.added.gaps += 1;
                    counts.added.missing = counts.added.missing.saturating_add(gap.count);
                    gap.to
                }
                Event::Clock(sample) => {
                    self.links.store(connection, &mut self.entities, host, sample, now).await?;
                    sample.at
                }
            };
            counts.newest = counts.newest.max(Some(at));
        }
        counts.added.events += batch.events.len() as u64;
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
        self.quarantined.extend(other.quarantined);
    }
}
