//! Opening of the file for writing: settings and migrations.

use std::path::Path;

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{ConnectOptions, SqliteConnection};

use super::file_kind::FileKind;
use super::foreign_log::assign_id;
use super::limits::BUSY_TIMEOUT;
use super::rebuild::build_missing_rollups;
use crate::database_error::{DatabaseError, is_damage};
use crate::error::OpenError;

/// Page cache of the writing connection: 64 MiB, so that the growing ends of the tables stay in memory. A negative
/// value means KiB.
const CACHE: &str = "-65536";

/// Number of pages in the write-ahead log (WAL) at which SQLite copies the pages into the file (checkpoint): about 64
/// MiB.
///
/// A commit of 100,000 nodes from a thousand agents changes some thousand pages; the next commit changes most of them
/// again. With SQLite's default of 1,000 pages every commit would checkpoint, sync the file once more, and take a third
/// to three quarters longer (measured in 1,000 interleaved repeats on a busy machine).
const CHECKPOINT_PAGES: &str = "16000";

/// Size in bytes to which SQLite truncates the write-ahead log's file when SQLite begins to write the log from its
/// start again. A long read may have made the file grow beyond this size. This is the usual size: the log's header, and
/// 16,000 pages with their frames' headers.
const TRUNCATED_WAL_BYTES: &str = "65920032";

pub(crate) static MIGRATIONS: Migrator = sqlx::migrate!("../../migrations");

/// Returns the settings of the connection that writes.
///
/// In WAL mode, readers can read while this connection writes. `synchronous=FULL` syncs the log at each commit. With
/// `NORMAL`, a power cut would lose batches that were acknowledged and that their agents have therefore deleted.
pub(crate) fn write_options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        // Only small tables declare foreign keys. A check for each node would halve the speed of storing.
        .foreign_keys(true)
        .pragma("cache_size", CACHE)
        .pragma("wal_autocheckpoint", CHECKPOINT_PAGES)
        .pragma("journal_size_limit", TRUNCATED_WAL_BYTES)
        .busy_timeout(BUSY_TIMEOUT)
        .disable_statement_logging()
}

/// Opens the file for writing, creates the file if it is missing, and brings its schema up to date.
pub(crate) async fn open(path: &Path) -> Result<SqliteConnection, OpenError> {
    connect_and_migrate(path, write_options(path)).await
}

/// Opens an existing file for writing, and brings its schema up to date.
pub(crate) async fn open_existing(path: &Path) -> Result<SqliteConnection, OpenError> {
    connect_and_migrate(path, write_options(path).create_if_missing(false)).await
}

/// Connects, checks that the file is an aggregator's database and can be written, runs missing migrations, and makes
/// the roll-ups that earlier versions did not make.
async fn connect_and_migrate(
    path: &Path,
    options: SqliteConnectOptions,
) -> Result<SqliteConnection, OpenError> {
    let cannot_open = |source| OpenError::cannot_open(path, source);
    let mut connection = options.connect().await.map_err(cannot_open)?;
    // A read-only file can be opened without an error, and the first batch would fail. This transaction shows the error
    // at once.
    sqlx::raw_sql("BEGIN IMMEDIATE; ROLLBACK").execute(&mut connection).await.map_err(cannot_open)?;
    let kind = FileKind::detect(&mut connection).await.map_err(cannot_open)?;
    if kind != FileKind::Empty
        && let Some(what) = kind.other_kind()
    {
        return Err(OpenError::NotADatabase { path: path.to_owned(), what });
    }
    // `None`: up to the newest migration. `false`: no migration is only marked as applied.
    MIGRATIONS.run_direct(None, &mut connection, false).await.map_err(|source| match source {
        MigrateError::VersionMissing(found) => {
            let supported = MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0);
            OpenError::NewerSchema { path: path.to_owned(), found, supported }
        }
        MigrateError::Execute(source) if is_damage(&source) => OpenError::cannot_open(path, source),
        source => OpenError::Migrate { path: path.to_owned(), source: DatabaseError::new(source) },
    })?;
    build_missing_rollups(&mut connection).await.map_err(|source| OpenError::Migrate {
        path: path.to_owned(),
        source: DatabaseError::new(MigrateError::Execute(source)),
    })?;
    // On a full disk the file can still be read. The first commit reports the error.
    if let Err(error) = assign_id(&mut connection).await {
        tracing::warn!(%error, database = %path.display(), "cannot write to the database yet; nothing is stored until a write succeeds");
    }
    Ok(connection)
}
