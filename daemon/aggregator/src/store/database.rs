//! Opening the file: settings, migrations, one writing connection and a pool of reading ones.

use std::path::Path;
use std::time::Duration;

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{ConnectOptions, SqliteConnection, SqlitePool};

use crate::error::StartError;

/// How long a question waits for a connection.
const ACQUIRE: Duration = Duration::from_secs(5);
/// Pages that the writing connection keeps, in negative KiB: 64 MiB, so that the tables' growing ends stay in memory.
const CACHE: &str = "-65536";

pub(crate) static MIGRATIONS: Migrator = sqlx::migrate!("../../migrations");

/// How long a connection waits for another program that locks the file.
const BUSY: Duration = Duration::from_secs(1);

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
        .busy_timeout(BUSY)
        .disable_statement_logging()
}

/// Opens the file for writing, making it when missing, and brings its schema up to date.
pub(crate) async fn open(path: &Path) -> Result<SqliteConnection, StartError> {
    let cannot_open = |source| StartError::Open { path: path.to_owned(), source };
    let mut connection = writing(path).connect().await.map_err(cannot_open)?;
    // A read-only file opens without complaint and fails at the first batch: find out now.
    sqlx::raw_sql("BEGIN IMMEDIATE; ROLLBACK").execute(&mut connection).await.map_err(cannot_open)?;
    MIGRATIONS.run_direct(None, &mut connection, false).await.map_err(|source| match source {
        MigrateError::VersionMissing(found) => {
            let known = MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0);
            StartError::NewerSchema { path: path.to_owned(), found, known }
        }
        source => StartError::Migrate { path: path.to_owned(), source },
    })?;
    Ok(connection)
}

/// Read-only connections, opened when needed.
pub(crate) fn readers(path: &Path, connections: u32) -> SqlitePool {
    let options = SqliteConnectOptions::new()
        .filename(path)
        .read_only(true)
        .busy_timeout(BUSY)
        .disable_statement_logging();
    SqlitePoolOptions::new().max_connections(connections).acquire_timeout(ACQUIRE).connect_lazy_with(options)
}
