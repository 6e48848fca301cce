//! Opening the file for writing: settings and migrations.

use std::path::Path;

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{ConnectOptions, SqliteConnection};

use super::contents::Contents;
use super::foreign_log::mark;
use super::limits::BUSY;
use super::rebuild::make_coarser;
use crate::database_error::{DatabaseError, is_damage};
use crate::error::OpenError;

/// Pages that the writing connection keeps, in negative KiB: 64 MiB, so that the tables' growing ends stay in memory.
const CACHE: &str = "-65536";

/// Pages in the log before they are carried over into the file, 64 MiB of them. A commit of 100,000 nodes from a thousand
/// agents changes some thousand pages, most of them again in the next one: with SQLite's 1,000 every commit would carry
/// over, sync the file once more, and take a third to three quarters longer (1,000 interleaved runs, a busy machine).
const CARRY_OVER: &str = "16000";

/// Bytes to which the log's file is cut when it is begun again after a reader had kept it growing: as many as it has
/// anyway, 16,000 pages with their frames' headers.
const LOG_BYTES: &str = "65920032";

pub(crate) static MIGRATIONS: Migrator = sqlx::migrate!("../../migrations");

/// Settings of the connection that writes.
///
/// WAL lets readers read while it writes. `synchronous=FULL` syncs the log at each commit: with NORMAL a power
/// cut would lose batches that were acknowledged, and that their agents have deleted.
pub(crate) fn writing(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(true)
        .pragma("cache_size", CACHE)
        .pragma("wal_autocheckpoint", CARRY_OVER)
        .pragma("journal_size_limit", LOG_BYTES)
        .busy_timeout(BUSY)
        .disable_statement_logging()
}

/// Opens the file for writing, making it when missing, and brings its schema up to date.
pub(crate) async fn open(path: &Path) -> Result<SqliteConnection, OpenError> {
    prepare(path, writing(path)).await
}

/// The same for a file that must exist.
pub(crate) async fn open_existing(path: &Path) -> Result<SqliteConnection, OpenError> {
    prepare(path, writing(path).create_if_missing(false)).await
}

async fn prepare(path: &Path, options: SqliteConnectOptions) -> Result<SqliteConnection, OpenError> {
    let cannot_open = |source| OpenError::opening(path, source);
    let mut connection = options.connect().await.map_err(cannot_open)?;
    // A read-only file opens without complaint and fails at the first batch: find out now.
    sqlx::raw_sql("BEGIN IMMEDIATE; ROLLBACK").execute(&mut connection).await.map_err(cannot_open)?;
    let contents = Contents::of(&mut connection).await.map_err(cannot_open)?;
    if let (true, Some(what)) = (contents != Contents::Nothing, contents.instead_of_database()) {
        return Err(OpenError::NotADatabase { path: path.to_owned(), what });
    }
    MIGRATIONS.run_direct(None, &mut connection, false).await.map_err(|source| match source {
        MigrateError::VersionMissing(found) => {
            let known = MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0);
            OpenError::NewerSchema { path: path.to_owned(), found, known }
        }
        MigrateError::Execute(source) if is_damage(&source) => OpenError::opening(path, source),
        source => OpenError::Migrate { path: path.to_owned(), source: DatabaseError::new(source) },
    })?;
    make_coarser(&mut connection).await.map_err(|source| OpenError::Migrate {
        path: path.to_owned(),
        source: DatabaseError::new(MigrateError::Execute(source)),
    })?;
    // On a full disk, say, the file is still good for reading, and the first commit tells.
    if let Err(error) = mark(&mut connection).await {
        tracing::warn!(%error, database = %path.display(), "cannot write to the database yet");
    }
    Ok(connection)
}
