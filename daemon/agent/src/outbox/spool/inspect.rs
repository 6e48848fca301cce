//! Inspection of a spool by another program, whether the agent of the spool runs or not.

use std::path::Path;
use std::time::Duration;

use futures::TryStreamExt;
use peernet_stream::ChainHash;
use serde::Serialize;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};

use super::error::is_corrupt;
use super::file_kind::APPLICATION_ID;

/// Longest wait for another program that has locked the file.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

/// Contents of a spool.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Inspection {
    /// Id of the host.
    pub host: String,
    /// Id of the stream.
    pub stream: String,
    /// Number of the newest batch that the aggregator has acknowledged.
    pub acknowledged: i64,
    /// Number of waiting batches.
    pub batches: u64,
    /// Numbers of the oldest and the newest waiting batch; `None` if no batch waits.
    #[serde(rename = "waiting")]
    pub waiting_range: Option<(i64, i64)>,
    /// Start time of the oldest waiting batch, in nanoseconds since 1970 UTC.
    pub oldest_ns: Option<i64>,
    /// Number of events in the waiting batches.
    pub events: u64,
    /// Number of bytes of these events.
    pub bytes: u64,
    /// Number of events that were queued since the file was created.
    pub produced: i64,
    /// Number of these events that were dropped and counted in gaps.
    pub dropped: i64,
    /// Number of dropped events that were lost because the agent was killed. `None` in a spool of an earlier release,
    /// which did not count these events separately.
    pub lost_when_killed: Option<i64>,
    /// All damage that was found.
    #[serde(skip)]
    pub damages: Vec<SpoolDamage>,
}

/// A kind of damage in a spool.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpoolDamage {
    /// SQLite finds the file damaged.
    #[error("SQLite reports damage in the spool (damaged places: {places}); the first report is: {first}")]
    Pages {
        /// Number of damaged places that SQLite reports, at most 100.
        places: usize,
        /// SQLite's text about the first damaged place.
        first: String,
    },
    /// SQLite cannot read the file or the rest of the file.
    #[error("the spool is damaged, or the file is not a spool: {0}")]
    Unreadable(String),
    /// The spool has no row for its stream and its host.
    #[error("the spool has no stream")]
    NoStream,
    /// Batches do not match their hashes.
    #[error("{batches} batches were changed after they were spooled; the first is number {first}")]
    Altered {
        /// Total number of changed batches.
        batches: usize,
        /// Number of the first changed batch.
        first: i64,
    },
    /// Batches are missing before this number.
    #[error("batches are missing before number {0}")]
    Missing(i64),
}

/// Reason why a file cannot be inspected.
#[derive(Debug, thiserror::Error)]
pub enum InspectError {
    /// The file is an aggregator's database.
    #[error("it is an aggregator's database and not an agent's spool")]
    Database,
    /// The file is empty.
    #[error("it is an empty file and not an agent's spool")]
    Empty,
    /// The file is a database of another program.
    #[error("it is the database of another program and not an agent's spool")]
    Other,
    /// The file cannot be opened or read.
    #[error(transparent)]
    Read(#[from] SpoolReadError),
}

/// Error of SQLite when a spool cannot be opened or read.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct SpoolReadError(#[from] sqlx::Error);

impl From<sqlx::Error> for InspectError {
    fn from(error: sqlx::Error) -> Self {
        Self::Read(SpoolReadError(error))
    }
}

/// Reads a whole spool in one transaction, also while its agent runs.
///
/// # Errors
/// When the file is not a spool or cannot be read. Damage is not an error: it is in [`Inspection::damages`].
pub async fn inspect(path: &Path) -> Result<Inspection, InspectError> {
    let mut inspection = Inspection::default();
    match inspection.read(path).await {
        Err(InspectError::Read(SpoolReadError(error))) if is_corrupt(&error) => {
            inspection.damages.push(SpoolDamage::Unreadable(error.to_string()));
            Ok(inspection)
        }
        result => result.map(|()| inspection),
    }
}

/// Returns the number of events that wait in a spool.
///
/// # Errors
/// When the spool cannot be read.
pub async fn pending_events(path: &Path) -> Result<u64, SpoolReadError> {
    let mut connection = read_only_options(path).connect().await?;
    let events: i64 =
        sqlx::query_scalar("SELECT COALESCE(SUM(events), 0) FROM batch").fetch_one(&mut connection).await?;
    connection.close().await?;
    Ok(u64::try_from(events).unwrap_or(0))
}

/// Returns the number of events lost by killed agents; `None` if the agent that wrote the spool did not count them.
async fn lost_when_killed(connection: &mut SqliteConnection) -> Result<Option<i64>, sqlx::Error> {
    // Spools of earlier releases do not have the column, and inspecting a file does not migrate it.
    let column = "SELECT count(*) > 0 FROM pragma_table_info('stream') WHERE name = 'lost_when_killed'";
    if !sqlx::query_scalar(column).fetch_one(&mut *connection).await? {
        return Ok(None);
    }
    sqlx::query_scalar("SELECT lost_when_killed FROM stream").fetch_optional(connection).await
}

pub(super) fn read_only_options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .read_only(true)
        .busy_timeout(BUSY_TIMEOUT)
        .disable_statement_logging()
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
        let mut connection = read_only_options(path).connect().await?;
        // All reads are in one transaction, so that concurrent writes of the agent do not look like damage.
        sqlx::query("BEGIN").execute(&mut connection).await?;
        // The kind is checked within the transaction. The result is returned after the connection is closed.
        let kind_result = check_is_spool(&mut connection).await;
        if kind_result.is_ok() {
            self.check_pages(&mut connection).await?;
            self.read_batches(&mut connection).await?;
        }
        connection.close().await?;
        kind_result
    }

    async fn check_pages(&mut self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        let mut problems: Vec<String> =
            sqlx::query_scalar("PRAGMA quick_check(100)").fetch_all(connection).await?;
        problems.retain(|line| line != "ok");
        let places = problems.len();
        self.damages.extend(problems.into_iter().next().map(|first| SpoolDamage::Pages { places, first }));
        Ok(())
    }

    async fn read_batches(&mut self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
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
        let (mut previous_number, mut previous_chain) =
            (stream.acknowledged, chain_from_bytes(&stream.chain));
        let mut rows = sqlx::query_as::<_, Batch>(
            "SELECT number, since_ns, events, chain, body FROM batch ORDER BY number",
        )
        .fetch(connection);
        let (mut altered_numbers, mut numbers_after_gaps) = (Vec::new(), Vec::new());
        while let Some(batch) = rows.try_next().await? {
            let is_consecutive = batch.number == previous_number + 1;
            let stored_chain = chain_from_bytes(&batch.chain);
            if !is_consecutive {
                numbers_after_gaps.push(batch.number);
            }
            // A batch after a missing batch cannot be checked, because the hash of the missing batch is unknown.
            if stored_chain.is_none()
                || (is_consecutive
                    && previous_chain.is_some_and(|previous| batch.chain_after(previous) != stored_chain))
            {
                altered_numbers.push(batch.number);
            }
            (previous_number, previous_chain) = (batch.number, stored_chain);
            self.count_batch(&batch);
        }
        if let Some(first) = altered_numbers.first() {
            self.damages.push(SpoolDamage::Altered { batches: altered_numbers.len(), first: *first });
        }
        self.damages.extend(numbers_after_gaps.first().copied().map(SpoolDamage::Missing));
        Ok(())
    }

    fn count_batch(&mut self, batch: &Batch) {
        self.batches += 1;
        self.waiting_range =
            Some((self.waiting_range.map_or(batch.number, |(first, _)| first), batch.number));
        self.oldest_ns = self.oldest_ns.or(Some(batch.since_ns));
        self.events += u64::try_from(batch.events).unwrap_or(0);
        self.bytes += batch.body.len() as u64;
    }
}

impl Batch {
    /// Returns the hash that the batch must have if the previous batch has the hash `previous`.
    fn chain_after(&self, previous: ChainHash) -> Option<ChainHash> {
        Some(previous.next(u32::try_from(self.events).unwrap_or(u32::MAX), &self.body))
    }
}

fn chain_from_bytes(bytes: &[u8]) -> Option<ChainHash> {
    bytes.try_into().ok().map(ChainHash::from_bytes)
}

/// Checks by the application id that the file is a spool. If it is not, the tables of the file determine the error.
async fn check_is_spool(connection: &mut SqliteConnection) -> Result<(), InspectError> {
    let id: i32 = sqlx::query_scalar("PRAGMA application_id").fetch_one(&mut *connection).await?;
    if id == APPLICATION_ID {
        return Ok(());
    }
    let (tables, aggregator_tables): (i64, i64) = sqlx::query_as(
        "SELECT count(*), coalesce(sum(name IN ('host', 'run', 'iteration')), 0) FROM sqlite_schema WHERE type = 'table'",
    )
    .fetch_one(connection)
    .await?;
    Err(match (tables, aggregator_tables) {
        // A new database of any program has no tables and no id yet.
        (0, _) => InspectError::Empty,
        (_, 3) => InspectError::Database,
        _ => InspectError::Other,
    })
}
