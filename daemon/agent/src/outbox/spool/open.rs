//! Opens the spool: settings, migrations, and the state in the file.

use std::fs::{self, File};
use std::path::Path;
use std::time::Duration;

use peernet_clock::{SharedClock, WallTime};
use peernet_logger::HostId;
use peernet_stream::{Chain, HandedInEvents, NewestSentBatch, SpoolState, StreamId, Totals, Usage};
use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, FromRow, SqliteConnection};

use super::aside::{beside, condemned, quarantine};
use super::error::{SpoolDefect, is_full};
use super::file::SpoolFile;
use super::file_kind::{APPLICATION_ID, FileKind};
use super::reserve::Reserve;
use super::statements::MAX_PROCESSES;
use super::{QuarantinedSpool, SpoolError, tail};
use crate::event_queue::EventCounter;
use crate::event_queue::counter::CountOwner;
use crate::lock::FileLock;

pub(super) static MIGRATIONS: Migrator = sqlx::migrate!("../../migrations/spool");

/// Longest wait for another program that reads the file.
const BUSY_TIMEOUT: Duration = Duration::from_secs(1);
/// Number of pages in the log after which it is moved to the file: 1 MiB.
const LOG_PAGES: &str = "256";
/// Length of the log that is kept after a large transaction, in bytes.
const LOG_BYTES: &str = "8388608";

/// A spool that is ready for use.
#[derive(Debug)]
pub(crate) struct OpenSpool {
    pub(in crate::outbox) file: SpoolFile,
    pub(in crate::outbox) state: SpoolState,
    /// Counter of the events that this process queues.
    pub(crate) counter: EventCounter,
    /// The broken spool that was moved aside, if there was one.
    pub(in crate::outbox) aside: Option<QuarantinedSpool>,
}

impl OpenSpool {
    /// Opens the spool of a host, and creates it if missing. A broken spool is moved aside. So is a file that cannot
    /// be recognised, but only at the agent's default path: elsewhere it may be somebody's data.
    ///
    /// # Errors
    /// When the spool cannot be opened, is not one, or belongs to another host.
    pub(crate) async fn open(
        path: &Path,
        host: HostId,
        is_default_path: bool,
        clock: &SharedClock,
    ) -> Result<Self, SpoolError> {
        let io = |action, path: &Path| {
            let path = path.to_owned();
            move |source| SpoolError::Io { action, path, source }
        };
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or_else(|| Path::new("."));
        fs::create_dir_all(folder).map_err(io("make", folder))?;
        // A separate file, because closing a second descriptor of the spool would release SQLite's locks on it.
        let lock_file = beside(path, "-lock");
        let lock = FileLock::try_acquire(&lock_file).map_err(io("lock", &lock_file))?;
        let lock = lock.ok_or_else(|| SpoolError::InUse(path.to_owned()))?;

        // Recognised before SQLite opens the file, which may change it.
        let file_kind = FileKind::at(path).map_err(io("read", path))?;
        if !(is_default_path && file_kind == FileKind::Other)
            && let Some(objection) = file_kind.objection()
        {
            return Err(SpoolError::NotASpool { path: path.to_owned(), objection });
        }
        let mut reserve = Reserve::new(beside(path, "-reserve"));
        let mut aside = None;
        let opened = match connect_in_any_room(path, host, &mut reserve).await {
            // A broken spool must not keep the robot from measuring. The file is kept, because its events may be
            // recovered by hand.
            Err(error) if error.is_damage() => {
                let put = quarantine(path, error.to_string(), clock.wall());
                aside = Some(put.map_err(io("put aside the damaged spool", path))?);
                connect_in_any_room(path, host, &mut reserve).await
            }
            opened => opened,
        };
        let (connection, state, counter) = opened?;
        // A new directory entry must be on the disk before the content counts as safe.
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(io("write", folder))?;
        // After the spool is open, because opening it may need that room.
        reserve.take();
        let file = SpoolFile::new(path.to_owned(), connection, reserve, counter.name().is_some(), lock)
            .map_err(io("look at", path))?;
        Ok(Self { file, state, counter, aside })
    }
}

/// Returns the settings of the connection.
///
/// With WAL and `synchronous=NORMAL` SQLite syncs only when it moves the log to the file. A crash of the process
/// loses nothing. A power cut loses what came since the log was last synced, which the spool's task does.
fn settings(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .auto_vacuum(SqliteAutoVacuum::Incremental)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Normal)
        .pragma("journal_size_limit", LOG_BYTES)
        .pragma("wal_autocheckpoint", LOG_PAGES)
        .busy_timeout(BUSY_TIMEOUT)
        .disable_statement_logging()
}

/// A connection, the state in the file, and the counter of this process.
type Connected = (SqliteConnection, SpoolState, EventCounter);

/// Connects, with the room of the reserve if the disk is full. Without any room this process does not count events,
/// and the losses of the previous process are found by a later start.
async fn connect_in_any_room(
    path: &Path,
    host: HostId,
    reserve: &mut Reserve,
) -> Result<Connected, SpoolError> {
    let opened = match connect(path, host, true).await {
        Err(error) if error.may_lack_room() && reserve.release() => connect(path, host, true).await,
        opened => opened,
    };
    match opened {
        Err(error) if error.may_lack_room() => {
            let opened = connect(path, host, false).await?;
            tracing::warn!(%error, "the spool's disk is full: what is lost when the agent is killed now is not reported");
            Ok(opened)
        }
        opened => opened,
    }
}

async fn connect(path: &Path, host: HostId, counts: bool) -> Result<Connected, SpoolError> {
    if let Some(reason) = condemned(path) {
        return Err(SpoolError::Damaged { path: path.to_owned(), what: SpoolDefect::Condemned(reason) });
    }
    let cannot_open = |source| SpoolError::Open { path: path.to_owned(), source };
    let mut connection = settings(path).connect().await.map_err(cannot_open)?;
    match prepare(path, host, &mut connection, counts).await {
        Ok((state, counter)) => Ok((connection, state, counter)),
        Err(error) => {
            // Closed before the file is moved, because closing deletes the log by its name.
            if let Err(error) = connection.close().await {
                tracing::debug!(%error, "the spool that could not be used was not closed cleanly");
            }
            Err(error)
        }
    }
}

async fn prepare(
    path: &Path,
    host: HostId,
    connection: &mut SqliteConnection,
    counts: bool,
) -> Result<(SpoolState, EventCounter), SpoolError> {
    let cannot_open = |source| SpoolError::Open { path: path.to_owned(), source };
    // SQLite opens a read-only file without an error: starting a write transaction reveals it.
    sqlx::raw_sql("BEGIN IMMEDIATE; ROLLBACK").execute(&mut *connection).await.map_err(cannot_open)?;
    claim(path, connection).await?;
    MIGRATIONS.run_direct(None, connection, false).await.map_err(|source| match source {
        MigrateError::VersionMissing(found) => {
            let known = MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0);
            SpoolError::NewerSchema { path: path.to_owned(), found, known }
        }
        MigrateError::Execute(source) if is_full(&source) => cannot_open(source),
        source => SpoolError::Migrate { path: path.to_owned(), source },
    })?;
    let row = stream(connection, host).await.map_err(cannot_open)?;
    // Its batches are events of that host: this one would report them as its own.
    if row.host != host.to_string() {
        return Err(SpoolError::OtherHost { path: path.to_owned(), found: row.host, own: host });
    }
    let held = held(connection).await.map_err(cannot_open)?;
    let reached = reached(connection).await.map_err(cannot_open)?;
    let state = row.state(held, reached);
    let mut state = state.map_err(|what| SpoolError::Damaged { path: path.to_owned(), what })?;
    state.unreported = tail::unreported(connection).await.map_err(cannot_open)?;
    let own = CountOwner::from_path(path).map_err(|source| SpoolError::Io {
        action: "look at",
        path: path.to_owned(),
        source,
    })?;
    state.unresolved = tail::unresolved(connection, &own).await.map_err(cannot_open)?;
    let counter = match counts {
        true => tail::begin(connection, &mut state, &own).await.map_err(cannot_open)?,
        false => EventCounter::default(),
    };
    Ok((state, counter))
}

/// Marks an empty database as a spool before it has tables. If the disk becomes full then, the file is still
/// recognised.
async fn claim(path: &Path, connection: &mut SqliteConnection) -> Result<(), SpoolError> {
    let cannot_open = |source| SpoolError::Open { path: path.to_owned(), source };
    let (id, tables): (i32, i64) = sqlx::query_as(
        "SELECT application_id, (SELECT COUNT(*) FROM sqlite_schema) FROM pragma_application_id",
    )
    .fetch_one(&mut *connection)
    .await
    .map_err(cannot_open)?;
    if id == APPLICATION_ID {
        return Ok(());
    }
    if let (true, Some(objection)) = (id != 0 || tables != 0, FileKind::Database.objection()) {
        return Err(SpoolError::NotASpool { path: path.to_owned(), objection });
    }
    let mark = AssertSqlSafe(format!("PRAGMA application_id = {APPLICATION_ID}"));
    sqlx::query(mark).execute(connection).await.map(drop).map_err(cannot_open)
}

#[derive(FromRow)]
struct StreamRow {
    uuid: String,
    host: String,
    previous: Option<String>,
    first: i64,
    events_before_first: Option<i64>,
    acknowledged: i64,
    chain: Vec<u8>,
    produced: i64,
    dropped: i64,
    gaps: i64,
    told: i64,
}

/// Returns the stream of the file. A new file begins one.
async fn stream(connection: &mut SqliteConnection, host: HostId) -> Result<StreamRow, sqlx::Error> {
    sqlx::query(
        "INSERT OR IGNORE INTO stream (id, uuid, host, first, events_before_first, acknowledged, chain) \
         VALUES (1, ?, ?, 1, 0, 0, ?)",
    )
    .bind(StreamId::random().to_string())
    .bind(host.to_string())
    .bind(Chain::START.as_bytes().as_slice())
    .execute(&mut *connection)
    .await?;
    sqlx::query_as(
        "SELECT uuid, host, previous, first, events_before_first, acknowledged, chain, produced, dropped, gaps, told
         FROM stream WHERE id = 1",
    )
    .fetch_one(connection)
    .await
}

/// Totals of the waiting batches.
#[derive(FromRow)]
struct WaitingTotals {
    batches: i64,
    events: i64,
    bytes: i64,
    since_ns: Option<i64>,
    newest: Option<i64>,
    chain: Option<Vec<u8>>,
}

async fn held(connection: &mut SqliteConnection) -> Result<WaitingTotals, sqlx::Error> {
    // length() of a blob reads its header only.
    sqlx::query_as(
        "SELECT COUNT(*) AS batches, COALESCE(SUM(events), 0) AS events, COALESCE(SUM(length(body)), 0) AS bytes,
                (SELECT since_ns FROM batch ORDER BY number LIMIT 1) AS since_ns, MAX(number) AS newest,
                (SELECT chain FROM batch ORDER BY number DESC LIMIT 1) AS chain
         FROM batch",
    )
    .fetch_one(connection)
    .await
}

/// Returns the last batch numbers of the newest processes.
async fn reached(connection: &mut SqliteConnection) -> Result<Vec<NewestSentBatch>, sqlx::Error> {
    let rows: Vec<(i64, i64)> =
        sqlx::query_as("SELECT process, number FROM reached ORDER BY number DESC LIMIT ?")
            .bind(MAX_PROCESSES)
            .fetch_all(connection)
            .await?;
    let reached = |(process, number): (i64, i64)| NewestSentBatch {
        process: process.cast_unsigned(),
        number: number.cast_unsigned(),
    };
    Ok(rows.into_iter().map(reached).collect())
}

impl StreamRow {
    fn state(self, held: WaitingTotals, reached: Vec<NewestSentBatch>) -> Result<SpoolState, SpoolDefect> {
        let id = |text: &str| text.parse().map_err(|_| SpoolDefect::StreamId(text.to_owned()));
        let before = chain(&self.chain)?;
        let acknowledged = self.acknowledged.cast_unsigned();
        let newest = match (held.newest, held.chain) {
            (Some(newest), Some(bytes)) => (newest.cast_unsigned(), chain(&bytes)?),
            _ => (acknowledged, before),
        };
        if newest.0 < acknowledged || self.first.cast_unsigned() > acknowledged + 1 {
            return Err(SpoolDefect::BatchNumbers { first: self.first, acknowledged, newest: newest.0 });
        }
        if held.batches.cast_unsigned() != newest.0 - acknowledged {
            tracing::warn!(
                batches = held.batches,
                "the spool lacks some of the batches {} to {}",
                acknowledged + 1,
                newest.0
            );
        }
        Ok(SpoolState {
            stream: id(&self.uuid)?,
            previous: self.previous.as_deref().map(id).transpose()?,
            first: self.first.cast_unsigned(),
            events_before_first: self.events_before_first.map(i64::cast_unsigned),
            oldest: acknowledged + 1,
            before,
            newest,
            since: held.since_ns.map(WallTime::from_unix_nanos),
            held: Usage { events: held.events.cast_unsigned(), bytes: held.bytes.cast_unsigned() },
            totals: Totals {
                produced: self.produced.cast_unsigned(),
                dropped: self.dropped.cast_unsigned(),
                gaps: self.gaps.cast_unsigned(),
                told: self.told.cast_unsigned(),
                handed_in: HandedInEvents::default(),
                reached: None,
                unreported: None,
            },
            reached,
            unreported: Vec::new(),
            unresolved: None,
        })
    }
}

/// Reads a chain from a column.
pub(super) fn chain(bytes: &[u8]) -> Result<Chain, SpoolDefect> {
    let bytes = <[u8; 16]>::try_from(bytes).map_err(|_| SpoolDefect::ChainLength(bytes.len()))?;
    Ok(Chain::from_bytes(bytes))
}
