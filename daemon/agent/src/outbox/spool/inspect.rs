//! Looking into a spool from outside, beside its agent or without one.

use std::path::Path;
use std::time::Duration;

use futures::TryStreamExt;
use peernet_stream::Chain;
use serde::Serialize;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};

use super::error::is_corrupt;
use super::look::APPLICATION_ID;

/// Time to wait for another program that locks the file.
const BUSY: Duration = Duration::from_secs(10);

/// The contents of a spool.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Inspection {
    /// The host's id.
    pub host: String,
    /// The stream's id.
    pub stream: String,
    /// All batches up to this number are stored by the aggregator.
    pub acknowledged: i64,
    /// Batches that wait.
    pub batches: u64,
    /// Numbers of the first and the last of them.
    pub waiting: Option<(i64, i64)>,
    /// Begin of the first of them, nanoseconds since 1970 UTC.
    pub oldest_ns: Option<i64>,
    /// Events in them.
    pub events: u64,
    /// Bytes of these events.
    pub bytes: u64,
    /// Events that were handed in since the file was made.
    pub produced: i64,
    /// Of those, dropped, and counted in gaps.
    pub dropped: i64,
    /// Of the dropped ones, those that were in the memory of an agent that was killed; the others found no room. `None` in a
    /// spool of an earlier release, which did not tell them apart.
    pub lost_when_killed: Option<i64>,
    /// Every damage that was found.
    #[serde(skip)]
    pub damages: Vec<SpoolDamage>,
}

/// One thing that is wrong with a spool.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpoolDamage {
    /// SQLite finds its file broken.
    #[error("the spool is damaged in {places} places, the first: {first}")]
    Pages {
        /// Number of findings, at most 100.
        places: usize,
        /// SQLite's words of the first.
        first: String,
    },
    /// SQLite cannot read on.
    #[error("the spool is damaged, or none: {0}")]
    Unreadable(String),
    /// It does not say whose events it holds.
    #[error("the spool has no stream")]
    NoStream,
    /// Batches do not have the hash that they had.
    #[error("{batches} batches are not what was spooled, the first is number {first}")]
    Altered {
        /// Number of such batches.
        batches: usize,
        /// The number of the first.
        first: i64,
    },
    /// Batches are missing in between.
    #[error("batches are missing before number {0}")]
    Missing(i64),
}

/// The reason why a file cannot be inspected.
#[derive(Debug, thiserror::Error)]
pub enum InspectError {
    /// It is an aggregator's database.
    #[error("it is an aggregator's database and not an agent's spool")]
    Database,
    /// It is an empty file.
    #[error("it is an empty file and not an agent's spool")]
    Empty,
    /// It is something else.
    #[error("it is the database of another program and not an agent's spool")]
    Other,
    /// It cannot be opened or read now.
    #[error(transparent)]
    Read(#[from] SpoolReadError),
}

/// SQLite cannot open or read a spool, in its own words.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct SpoolReadError(#[from] sqlx::Error);

impl From<sqlx::Error> for InspectError {
    fn from(error: sqlx::Error) -> Self {
        Self::Read(SpoolReadError(error))
    }
}

/// Reads a whole spool at one moment, beside a running agent if there is one.
///
/// # Errors
/// If the file is no spool or cannot be read. A damaged spool is not an error: [`Inspection::damages`] lists the damage.
pub async fn inspect(path: &Path) -> Result<Inspection, InspectError> {
    let mut found = Inspection::default();
    match found.read(path).await {
        Err(InspectError::Read(SpoolReadError(error))) if is_corrupt(&error) => {
            found.damages.push(SpoolDamage::Unreadable(error.to_string()));
            Ok(found)
        }
        read => read.map(|()| found),
    }
}

/// Events that wait in a spool.
///
/// # Errors
/// If the spool cannot be read.
pub async fn waiting_events(path: &Path) -> Result<u64, SpoolReadError> {
    let mut connection = reading(path).connect().await?;
    let events: i64 =
        sqlx::query_scalar("SELECT COALESCE(SUM(events), 0) FROM batch").fetch_one(&mut connection).await?;
    connection.close().await?;
    Ok(u64::try_from(events).unwrap_or(0))
}

/// The losses of killed agents; `None` where the agent that wrote the spool did not count them.
async fn lost_when_killed(connection: &mut SqliteConnection) -> Result<Option<i64>, sqlx::Error> {
    let column = "SELECT count(*) > 0 FROM pragma_table_info('stream') WHERE name = 'lost_when_killed'";
    if !sqlx::query_scalar(column).fetch_one(&mut *connection).await? {
        return Ok(None);
    }
    sqlx::query_scalar("SELECT lost_when_killed FROM stream").fetch_optional(connection).await
}

fn reading(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new().filename(path).read_only(true).busy_timeout(BUSY).disable_statement_logging()
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

impl Inspection {
    async fn read(&mut self, path: &Path) -> Result<(), InspectError> {
        let mut connection = reading(path).connect().await?;
        sqlx::query("BEGIN").execute(&mut connection).await?;
        let is_spool = refuse_others(&mut connection).await;
        if is_spool.is_ok() {
            self.pages(&mut connection).await?;
            self.contents(&mut connection).await?;
        }
        connection.close().await?;
        is_spool
    }

    async fn pages(&mut self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        let mut found: Vec<String> =
            sqlx::query_scalar("PRAGMA quick_check(100)").fetch_all(connection).await?;
        found.retain(|line| line != "ok");
        let places = found.len();
        self.damages.extend(found.into_iter().next().map(|first| SpoolDamage::Pages { places, first }));
        Ok(())
    }

    async fn contents(&mut self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        let stream: Option<Stream> =
            sqlx::query_as("SELECT uuid, host, acknowledged, chain, produced, dropped FROM stream")
                .fetch_optional(&mut *connection)
                .await?;
        let Some(stream) = stream else {
            self.damages.push(SpoolDamage::NoStream);
            return Ok(());
        };
        (self.host, self.stream) = (stream.host, stream.uuid);
        (self.acknowledged, self.produced, self.dropped) =
            (stream.acknowledged, stream.produced, stream.dropped);
        self.lost_when_killed = lost_when_killed(connection).await?;
        let mut before = (stream.acknowledged, chain(&stream.chain));
        let mut rows = sqlx::query_as::<_, Batch>(
            "SELECT number, since_ns, events, chain, body FROM batch ORDER BY number",
        )
        .fetch(connection);
        let (mut altered, mut holes) = (Vec::new(), Vec::new());
        while let Some(batch) = rows.try_next().await? {
            let follows = batch.number == before.0 + 1;
            let stored = chain(&batch.chain);
            if !follows {
                holes.push(batch.number);
            }
            if stored.is_none() || (follows && before.1.is_some_and(|before| batch.after(before) != stored)) {
                altered.push(batch.number);
            }
            before = (batch.number, stored);
            self.count(&batch);
        }
        if let Some(first) = altered.first() {
            self.damages.push(SpoolDamage::Altered { batches: altered.len(), first: *first });
        }
        self.damages.extend(holes.first().copied().map(SpoolDamage::Missing));
        Ok(())
    }

    fn count(&mut self, batch: &Batch) {
        self.batches += 1;
        self.waiting = Some((self.waiting.map_or(batch.number, |(first, _)| first), batch.number));
        self.oldest_ns = self.oldest_ns.or(Some(batch.since_ns));
        self.events += u64::try_from(batch.events).unwrap_or(0);
        self.bytes += batch.body.len() as u64;
    }
}

impl Batch {
    /// Its hash where the one before it has this one.
    fn after(&self, before: Chain) -> Option<Chain> {
        Some(before.then(u32::try_from(self.events).unwrap_or(u32::MAX), &self.body))
    }
}

fn chain(bytes: &[u8]) -> Option<Chain> {
    bytes.try_into().ok().map(Chain::from_bytes)
}

/// Refuses what is no spool, by what is written in its header, and by its tables.
async fn refuse_others(connection: &mut SqliteConnection) -> Result<(), InspectError> {
    let id: i32 = sqlx::query_scalar("PRAGMA application_id").fetch_one(&mut *connection).await?;
    if id == APPLICATION_ID {
        return Ok(());
    }
    let (all, database): (i64, i64) = sqlx::query_as(
        "SELECT count(*), coalesce(sum(name IN ('host', 'run', 'iteration')), 0) FROM sqlite_schema WHERE type = 'table'",
    )
    .fetch_one(connection)
    .await?;
    Err(match (all, database) {
        (0, _) => InspectError::Empty,
        (_, 3) => InspectError::Database,
        _ => InspectError::Other,
    })
}
