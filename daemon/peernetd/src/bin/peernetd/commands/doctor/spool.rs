//! An agent's spool: what waits in it, and whether each batch is what it was.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail};
use futures::TryStreamExt;
use peernet_aggregator::maintenance::{Contents, Finding, Severity, free_bytes};
use peernet_stream::Chain;
use serde::Serialize;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};

/// How long another program that locks the file is waited for.
const BUSY: Duration = Duration::from_secs(10);
/// A disk with less room is as good as full.
const LITTLE_ROOM: u64 = 16 << 20;
/// What to do about a damaged spool.
const RENEW: &str = "stop the agent, move the file with its -wal to another folder and keep it, start the agent again: it \
                     makes a new one, and the aggregator records what was lost as a gap";

/// What to do about a disk without room.
const MAKE_ROOM: &str = "make room: what is measured while the aggregator is away and does not fit into the agent's \
                         memory is lost, and counted";

/// The state of a spool.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct SpoolReport {
    pub(super) spool: PathBuf,
    pub(super) host: String,
    /// The stream's id.
    pub(super) stream: String,
    /// All batches up to this number are stored by the aggregator.
    pub(super) acknowledged: i64,
    /// Batches that wait.
    pub(super) batches: u64,
    /// Numbers of the first and the last of them.
    pub(super) waiting: Option<(i64, i64)>,
    /// When the first of them began.
    pub(super) oldest_ns: Option<i64>,
    /// Events in them.
    pub(super) events: u64,
    /// Bytes of these events.
    pub(super) bytes: u64,
    /// Size of the file and its log.
    pub(super) file_bytes: u64,
    /// Room that is left on its disk, beside what the agent holds there for deleting.
    pub(super) disk_free_bytes: u64,
    /// Events that were handed in since the file was made.
    pub(super) produced: i64,
    /// Of those, dropped for want of room.
    pub(super) dropped: i64,
    pub(super) findings: Vec<Finding>,
}

#[derive(sqlx::FromRow)]
struct Stream {
    uuid: String,
    host: String,
    acknowledged: i64,
    chain: Vec<u8>,
    produced: i64,
    dropped: i64,
}

#[derive(sqlx::FromRow)]
struct Batch {
    number: i64,
    since_ns: i64,
    events: i64,
    chain: Vec<u8>,
    body: Vec<u8>,
}

/// Reads the whole spool at one moment, beside a running agent if there is one.
pub(super) async fn examine(path: &Path) -> anyhow::Result<SpoolReport> {
    if !path.is_file() {
        bail!(
            "there is no spool {}; an agent makes it when it starts with [agent] aggregator",
            path.display()
        );
    }
    let mut report = SpoolReport { spool: path.to_owned(), ..SpoolReport::default() };
    let length = |path: &Path| std::fs::metadata(path).map_or(0, |file| file.len());
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    report.file_bytes = length(path) + length(Path::new(&log));
    report.room(path);
    let options = SqliteConnectOptions::new()
        .filename(path)
        .read_only(true)
        .busy_timeout(BUSY)
        .disable_statement_logging();
    let read = async {
        let mut connection = options.connect().await?;
        sqlx::query("BEGIN").execute(&mut connection).await?;
        let contents = Contents::of(&mut connection).await?;
        if contents != Contents::Spool {
            report.is_something_else(contents);
            return connection.close().await;
        }
        let said: Vec<String> =
            sqlx::query_scalar("PRAGMA quick_check(100)").fetch_all(&mut connection).await?;
        let damages: Vec<String> = said.into_iter().filter(|line| line != "ok").collect();
        if let Some(first) = damages.first() {
            report.damaged(format!("the spool is damaged in {} places, the first: {first}", damages.len()));
        }
        report.batches(&mut connection).await?;
        connection.close().await
    };
    match read.await {
        Ok(()) => {}
        Err(sqlx::Error::Database(error)) if matches!(error.code().as_deref(), Some("11" | "26")) => {
            report.damaged(format!("the spool is damaged, or none: {error}"));
        }
        // SQLite needs some room even to read.
        Err(error) if report.disk_free_bytes < LITTLE_ROOM => {
            report.problem(format!("the spool cannot be read: {error}"), MAKE_ROOM);
        }
        Err(error) => return Err(error).with_context(|| format!("cannot read the spool {}", path.display())),
    }
    Ok(report)
}

impl SpoolReport {
    fn is_something_else(&mut self, contents: Contents) {
        let (what, advice) = match contents {
            Contents::Database => {
                ("an aggregator's database", "look at it with `peernetd doctor --database FILE`")
            }
            Contents::Nothing => ("an empty file", "start its agent, which makes it"),
            Contents::Spool | Contents::Other => {
                ("the database of another program", "name the file of [spool] file")
            }
        };
        let what = format!("it is {what} and not an agent's spool");
        self.problem(what, advice);
    }

    fn room(&mut self, path: &Path) {
        match free_bytes(path) {
            Ok(bytes) => {
                self.disk_free_bytes = bytes;
                if bytes < LITTLE_ROOM {
                    self.problem(format!("its disk has only {} KiB of room", bytes >> 10), MAKE_ROOM);
                }
            }
            Err(error) => self.problem(format!("cannot tell how full its disk is: {error}"), "look at `df`"),
        }
    }

    fn problem(&mut self, what: String, advice: &str) {
        self.findings.push(Finding { severity: Severity::Problem, what, advice: advice.to_owned() });
    }

    fn damaged(&mut self, what: String) {
        self.problem(what, RENEW);
    }

    async fn batches(&mut self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        let stream: Option<Stream> =
            sqlx::query_as("SELECT uuid, host, acknowledged, chain, produced, dropped FROM stream")
                .fetch_optional(&mut *connection)
                .await?;
        let Some(stream) = stream else {
            self.damaged("the spool has no stream".to_owned());
            return Ok(());
        };
        (self.host, self.stream) = (stream.host, stream.uuid);
        (self.acknowledged, self.produced, self.dropped) =
            (stream.acknowledged, stream.produced, stream.dropped);
        let mut before = (stream.acknowledged, chain(&stream.chain));
        let mut rows = sqlx::query_as::<_, Batch>(
            "SELECT number, since_ns, events, chain, body FROM batch ORDER BY number",
        )
        .fetch(connection);
        let mut wrong = Vec::new();
        let mut holes = Vec::new();
        while let Some(batch) = rows.try_next().await? {
            self.batches += 1;
            self.waiting = Some((self.waiting.map_or(batch.number, |(first, _)| first), batch.number));
            self.oldest_ns = self.oldest_ns.or(Some(batch.since_ns));
            self.events += u64::try_from(batch.events).unwrap_or(0);
            self.bytes += batch.body.len() as u64;
            if batch.number != before.0 + 1 {
                holes.push(batch.number);
            }
            let events = u32::try_from(batch.events).unwrap_or(u32::MAX);
            let stored = chain(&batch.chain);
            let known = before.1.filter(|_| batch.number == before.0 + 1);
            if stored.is_none()
                || known.is_some_and(|before| Some(before.then(events, &batch.body)) != stored)
            {
                wrong.push(batch.number);
            }
            before = (batch.number, stored);
        }
        drop(rows);
        if let Some(first) = wrong.first() {
            self.damaged(format!(
                "{} batches are not what was spooled, the first is number {first}",
                wrong.len()
            ));
        }
        if let Some(first) = holes.first() {
            self.damaged(format!("batches are missing before number {first}"));
        }
        if self.dropped > 0 {
            self.findings.push(Finding {
                severity: Severity::Notice,
                what: format!(
                    "{} events were dropped for want of room, and are told of as gaps",
                    self.dropped
                ),
                advice: "raise [spool] limit_bytes, or look why the aggregator was away".to_owned(),
            });
        }
        Ok(())
    }
}

fn chain(bytes: &[u8]) -> Option<Chain> {
    bytes.try_into().ok().map(Chain::from_bytes)
}
