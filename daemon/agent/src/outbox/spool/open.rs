//! Opens the spool: settings, migrations, and the state in the file.

use std::fs::{self, File};
use std::io;
use std::path::Path;
use std::time::Duration;

use peernet_clock::{SharedClock, WallTime};
use peernet_logger::HostId;
use peernet_stream::{ChainHash, NewestSendableBatch, SpoolState, StreamId, SubmittedEvents, Totals, Usage};
use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, FromRow, SqliteConnection};

use super::error::{SpoolDefect, is_full};
use super::file::SpoolFile;
use super::file_kind::{APPLICATION_ID, FileKind};
use super::quarantine::{quarantine, quarantine_reason, with_suffix};
use super::recovery::recover;
use super::reserve::Reserve;
use super::statements::MAX_PROCESSES;
use super::{QuarantinedSpool, SpoolError, killed_process};
use crate::event_queue::EventCounter;
use crate::event_queue::counter::{CountOwner, LockedCounts};
use crate::lock::FileLock;

pub(super) static MIGRATIONS: Migrator = sqlx::migrate!("../../migrations/spool");

/// Longest wait for another program that reads the file.
const BUSY_TIMEOUT: Duration = Duration::from_secs(1);
/// Number of pages, as text, at which SQLite moves the write-ahead log to the file: 1 MiB.
const CHECKPOINT_WAL_PAGES: &str = "256";
/// Length in bytes, as text, to which the write-ahead log is truncated after a large transaction.
const TRUNCATED_WAL_BYTES: &str = "8388608";

/// A spool that is ready for use.
#[derive(Debug)]
pub(crate) struct OpenSpool {
    pub(in crate::outbox) file: SpoolFile,
    pub(in crate::outbox) state: SpoolState,
    /// Counter of the events that this process queues.
    pub(crate) counter: EventCounter,
    /// The damaged spool that was quarantined, if any.
    pub(in crate::outbox) quarantined: Option<QuarantinedSpool>,
    /// `true` if the file existed and had no content, so that a spool was truncated.
    pub(in crate::outbox) was_empty: bool,
}

impl OpenSpool {
    /// Opens the spool of a host, and creates the spool if it does not exist. A damaged spool is quarantined. At the
    /// default path (`is_default_path`) a file that is not an SQLite file is quarantined, too. At a configured path
    /// such a file is an error, because it may contain data of the user.
    ///
    /// # Errors
    /// When the spool cannot be opened, the file is not a spool, or the spool belongs to another host.
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
        fs::create_dir_all(folder).map_err(io("create", folder))?;
        // The lock is on a separate file, because closing a second descriptor of the spool would release the locks that
        // SQLite has on the spool.
        let lock_file = with_suffix(path, "-lock");
        let lock = FileLock::try_acquire(&lock_file).map_err(io("lock", &lock_file))?;
        let lock = lock.ok_or_else(|| SpoolError::InUse(path.to_owned()))?;

        // The file is checked before SQLite opens it, because SQLite may change it.
        let file_kind = FileKind::from_path(path).map_err(io("read", path))?;
        if !(is_default_path && file_kind == FileKind::Other)
            && let Some(refusal_reason) = file_kind.refusal_reason()
        {
            return Err(SpoolError::NotASpool { path: path.to_owned(), refusal_reason });
        }
        let mut reserve = Reserve::new(with_suffix(path, "-reserve"));
        let was_empty = is_empty_file(path).map_err(io("read", path))?;
        let mut quarantined = None;
        let connect_result = match connect_despite_full_disk(path, host, &mut reserve).await {
            // A damaged spool must not prevent the robot from measuring. The file is not deleted, because a user may
            // recover its events.
            Err(error) if error.is_damage() => {
                let counts = CountOwner::from_path(path).map(|spool| LockedCounts::of_spool(&spool));
                let quarantine_result = quarantine(path, error.damage(), clock.wall());
                let mut moved = quarantine_result.map_err(io("quarantine the damaged spool", path))?;
                let recovered = recover(&moved.new_path, path, host).await;
                moved.recovered = recovered.map_err(|error| error.to_string());
                // Without the assignment, the recovered spool would be taken for a copy of the damaged one, and the events
                // that the previous process lost would not be reported.
                if moved.recovered.is_ok()
                    && let Err(error) =
                        counts.and_then(|counts| counts.assign_to(&CountOwner::from_path(path)?))
                {
                    tracing::warn!(%error, "cannot assign the count of queued events to the recovered spool; the events that were lost are not reported");
                }
                quarantined = Some(moved);
                connect_despite_full_disk(path, host, &mut reserve).await
            }
            result => result,
        };
        let (connection, state, counter) = connect_result?;
        // The directory entry of a new file must be on the disk, or a power cut could remove the file.
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(io("write", folder))?;
        // The reserve is allocated after the spool was opened, because opening may need the space.
        reserve.allocate();
        let file = SpoolFile::new(path.to_owned(), connection, reserve, counter.name().is_some(), lock)
            .map_err(io("read", path))?;
        Ok(Self { file, state, counter, quarantined, was_empty })
    }
}

/// Returns whether a file exists, and neither the file nor its write-ahead log has any content.
fn is_empty_file(path: &Path) -> io::Result<bool> {
    let length = |path: &Path| match fs::metadata(path) {
        Ok(metadata) => Ok(Some(metadata.len())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    };
    Ok(length(path)? == Some(0) && length(&with_suffix(path, "-wal"))?.unwrap_or(0) == 0)
}

/// Returns the settings of the connection.
///
/// With a write-ahead log and `synchronous=NORMAL`, SQLite syncs only when it moves the log to the file. A crash of the
/// process loses no transaction. A power cut loses the transactions since the spool's task last synced the log.
pub(super) fn settings(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .auto_vacuum(SqliteAutoVacuum::Incremental)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Normal)
        .pragma("journal_size_limit", TRUNCATED_WAL_BYTES)
        .pragma("wal_autocheckpoint", CHECKPOINT_WAL_PAGES)
        .busy_timeout(BUSY_TIMEOUT)
        .disable_statement_logging()
}

/// A connection, the state in the file, and the counter of this process.
type ConnectedSpool = (SqliteConnection, SpoolState, EventCounter);

/// Connects to the spool. If the disk is full, the reserve is released. If the disk is still full, this process does
/// not count its events, and a later start of the agent determines the losses of the previous process.
async fn connect_despite_full_disk(
    path: &Path,
    host: HostId,
    reserve: &mut Reserve,
) -> Result<ConnectedSpool, SpoolError> {
    let counts_events = true;
    let result = match connect(path, host, counts_events).await {
        Err(error) if error.may_be_full_disk() && reserve.release() => {
            connect(path, host, counts_events).await
        }
        result => result,
    };
    match result {
        Err(error) if error.may_be_full_disk() => {
            let counts_events = false;
            let connected = connect(path, host, counts_events).await?;
            tracing::warn!(%error, "the spool's disk is full; if the agent is killed, its lost events are not reported");
            Ok(connected)
        }
        result => result,
    }
}

/// Opens the connection and prepares the file, or closes the connection if that fails.
async fn connect(path: &Path, host: HostId, counts_events: bool) -> Result<ConnectedSpool, SpoolError> {
    if let Some(reason) = quarantine_reason(path) {
        return Err(SpoolError::Damaged { path: path.to_owned(), defect: SpoolDefect::DamageFlag(reason) });
    }
    let cannot_open = |source| SpoolError::Open { path: path.to_owned(), source };
    let mut connection = settings(path).connect().await.map_err(cannot_open)?;
    match prepare(path, host, &mut connection, counts_events).await {
        Ok((state, counter)) => Ok((connection, state, counter)),
        Err(error) => {
            // The connection is closed before the file is renamed, because closing deletes the write-ahead log by its
            // name.
            if let Err(error) = connection.close().await {
                tracing::debug!(%error, "closing the unusable spool failed");
            }
            Err(error)
        }
    }
}

/// Creates or migrates the tables, and reads the state of the stream. `counts_events` is `true` if this process counts
/// its events in a new counter.
async fn prepare(
    path: &Path,
    host: HostId,
    connection: &mut SqliteConnection,
    counts_events: bool,
) -> Result<(SpoolState, EventCounter), SpoolError> {
    let cannot_open = |source| SpoolError::Open { path: path.to_owned(), source };
    // SQLite opens a read-only file without an error; the start of a write transaction fails.
    sqlx::raw_sql("BEGIN IMMEDIATE; ROLLBACK").execute(&mut *connection).await.map_err(cannot_open)?;
    set_application_id(path, connection).await?;
    // `None` means up to the newest migration; with `true` the migrations would be recorded but not executed.
    MIGRATIONS.run_direct(None, connection, false).await.map_err(|source| match source {
        MigrateError::VersionMissing(found) => {
            let newest_known = MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0);
            SpoolError::NewerSchema { path: path.to_owned(), found, known: newest_known }
        }
        MigrateError::Execute(source) if is_full(&source) => cannot_open(source),
        source => SpoolError::Migrate { path: path.to_owned(), source },
    })?;
    let row = read_or_create_stream(connection, host).await.map_err(cannot_open)?;
    // A spool of another host is refused, because this host would send the events of the other host as its own.
    if row.host != host.to_string() {
        return Err(SpoolError::OtherHost { path: path.to_owned(), found: row.host, own: host });
    }
    let waiting = waiting_totals(connection).await.map_err(cannot_open)?;
    let newest_sendable = newest_sendable_batches(connection).await.map_err(cannot_open)?;
    let state = row.into_state(waiting, newest_sendable);
    let mut state = state.map_err(|defect| SpoolError::Damaged { path: path.to_owned(), defect })?;
    state.unreported = killed_process::read_unreported(connection).await.map_err(cannot_open)?;
    let owner = CountOwner::from_path(path).map_err(|source| SpoolError::Io {
        action: "read",
        path: path.to_owned(),
        source,
    })?;
    state.unresolved = killed_process::read_unresolved(connection, &owner).await.map_err(cannot_open)?;
    let counter = match counts_events {
        true => killed_process::start_counter(connection, &mut state, &owner).await.map_err(cannot_open)?,
        false => EventCounter::default(),
    };
    Ok((state, counter))
}

/// Sets the application id of an empty database before its tables are created. The file is then recognised as a spool
/// even if the disk becomes full before the tables exist.
pub(super) async fn set_application_id(
    path: &Path,
    connection: &mut SqliteConnection,
) -> Result<(), SpoolError> {
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
    if let (true, Some(refusal_reason)) = (id != 0 || tables != 0, FileKind::Database.refusal_reason()) {
        return Err(SpoolError::NotASpool { path: path.to_owned(), refusal_reason });
    }
    let set_id = AssertSqlSafe(format!("PRAGMA application_id = {APPLICATION_ID}"));
    sqlx::query(set_id).execute(connection).await.map(drop).map_err(cannot_open)
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
    #[sqlx(rename = "told")]
    reported_drops: i64,
}

/// Returns the stream of the file; creates it in a new file.
async fn read_or_create_stream(
    connection: &mut SqliteConnection,
    host: HostId,
) -> Result<StreamRow, sqlx::Error> {
    sqlx::query(
        "INSERT OR IGNORE INTO stream (id, uuid, host, first, events_before_first, acknowledged, chain) \
         VALUES (1, ?, ?, 1, 0, 0, ?)",
    )
    .bind(StreamId::random().to_string())
    .bind(host.to_string())
    .bind(ChainHash::START.as_bytes().as_slice())
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

async fn waiting_totals(connection: &mut SqliteConnection) -> Result<WaitingTotals, sqlx::Error> {
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

/// Returns the newest batch that each process was allowed to send, the largest number first, for at most
/// [`MAX_PROCESSES`] processes.
async fn newest_sendable_batches(
    connection: &mut SqliteConnection,
) -> Result<Vec<NewestSendableBatch>, sqlx::Error> {
    let rows: Vec<(i64, i64)> =
        sqlx::query_as("SELECT process, number FROM reached ORDER BY number DESC LIMIT ?")
            .bind(MAX_PROCESSES)
            .fetch_all(connection)
            .await?;
    let batch_of_row = |(process, number): (i64, i64)| NewestSendableBatch {
        process: process.cast_unsigned(),
        number: number.cast_unsigned(),
    };
    Ok(rows.into_iter().map(batch_of_row).collect())
}

impl StreamRow {
    /// Returns the state of the spool for the state machine.
    ///
    /// # Errors
    /// When the row is inconsistent with the waiting batches.
    fn into_state(
        self,
        waiting: WaitingTotals,
        newest_sendable: Vec<NewestSendableBatch>,
    ) -> Result<SpoolState, SpoolDefect> {
        let id = |text: &str| text.parse().map_err(|_| SpoolDefect::StreamId(text.to_owned()));
        let acknowledged_chain = chain_from_column(&self.chain)?;
        let acknowledged = self.acknowledged.cast_unsigned();
        let (newest, newest_chain) = match (waiting.newest, waiting.chain) {
            (Some(newest), Some(bytes)) => (newest.cast_unsigned(), chain_from_column(&bytes)?),
            _ => (acknowledged, acknowledged_chain),
        };
        if newest < acknowledged || self.first.cast_unsigned() > acknowledged + 1 {
            return Err(SpoolDefect::BatchNumbers { first: self.first, acknowledged, newest });
        }
        if waiting.batches.cast_unsigned() != newest - acknowledged {
            tracing::warn!(
                batches = waiting.batches,
                "the spool lacks some of the batches {} to {}",
                acknowledged + 1,
                newest
            );
        }
        Ok(SpoolState {
            stream: id(&self.uuid)?,
            previous_stream: self.previous.as_deref().map(id).transpose()?,
            first: self.first.cast_unsigned(),
            events_before_first: self.events_before_first.map(i64::cast_unsigned),
            oldest: acknowledged + 1,
            chain_before_oldest: acknowledged_chain,
            newest: (newest, newest_chain),
            since: waiting.since_ns.map(WallTime::from_unix_nanos),
            waiting_usage: Usage {
                events: waiting.events.cast_unsigned(),
                bytes: waiting.bytes.cast_unsigned(),
            },
            totals: Totals {
                produced: self.produced.cast_unsigned(),
                dropped: self.dropped.cast_unsigned(),
                gaps: self.gaps.cast_unsigned(),
                reported_drops: self.reported_drops.cast_unsigned(),
                submitted: SubmittedEvents::default(),
                newest_sendable: None,
                unreported: None,
            },
            newest_sendable,
            unreported: Vec::new(),
            unresolved: None,
        })
    }
}

/// Reads a chain hash from a column.
pub(super) fn chain_from_column(bytes: &[u8]) -> Result<ChainHash, SpoolDefect> {
    let bytes = <[u8; 16]>::try_from(bytes).map_err(|_| SpoolDefect::ChainLength(bytes.len()))?;
    Ok(ChainHash::from_bytes(bytes))
}
