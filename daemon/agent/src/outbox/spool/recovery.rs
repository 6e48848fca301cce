//! Recovers the intact batches of a quarantined spool.
//!
//! The batches before the first damaged batch are copied to a new spool of the same stream. Agent and aggregator treat
//! this spool like a spool that lost its newest batches in a power cut: they compare the chain hashes at the
//! aggregator's mark before a batch is sent, so that no recovered batch is stored twice. Batches behind the damage are
//! not copied, because without the damaged batches their chain hashes cannot be checked.

use std::fs;
use std::io;
use std::path::Path;

use peernet_logger::HostId;
use peernet_stream::ChainHash;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};

use super::error::is_corrupt;
use super::inspect::read_only_options;
use super::open::{MIGRATIONS, chain_from_column, set_application_id, settings};
use super::quarantine::with_suffix;

/// Tables that are copied whole: the state of the stream.
const STATE_TABLES: [&str; 4] = ["stream", "reached", "unreported", "unresolved"];
/// Minimum number of bytes that a batch takes in a file. The batch numbers in a damaged file may be wrong, so a number
/// of lost batches for which the file is too short is ignored.
const MIN_BATCH_BYTES: u64 = 16;

/// Numbers of recovered and of lost batches of a quarantined spool, and of their events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::outbox) struct RecoveryCounts {
    /// Number of intact batches, which are in the new spool.
    pub(in crate::outbox) batches: u64,
    /// Number of events in these batches.
    pub(in crate::outbox) events: u64,
    /// Number of batches that are only in the quarantined file; `None` if this number cannot be read.
    pub(in crate::outbox) lost_batches: Option<u64>,
    /// Number of events in those lost batches for which the number of events can be read.
    pub(in crate::outbox) lost_events: u64,
}

/// Reason why nothing was recovered.
#[derive(Debug, thiserror::Error)]
pub(super) enum RecoveryError {
    /// SQLite cannot read the damaged file, or cannot write the new one.
    #[error(transparent)]
    Sqlite(#[from] sqlx::Error),
    /// The tables of the new spool cannot be created.
    #[error("cannot create a new spool: {0}")]
    Create(String),
    /// The spool has no batch, or its first batch is damaged.
    #[error("no batch can be read before the damage")]
    NoBatch,
    /// The damaged spool belongs to another host, or has no stream.
    #[error("the spool does not name this host as its owner")]
    OtherHost,
}

/// Creates a spool with the state and the intact batches of a damaged spool. If no batch is intact, creates no spool.
///
/// # Errors
/// When the state of the stream cannot be read, no batch is intact, or the new spool cannot be written.
pub(super) async fn recover(
    damaged: &Path,
    spool: &Path,
    host: HostId,
) -> Result<RecoveryCounts, RecoveryError> {
    let mut source = read_only_options(damaged).connect().await?;
    let file_bytes = fs::metadata(damaged).map_or(0, |metadata| metadata.len());
    let result = create(&mut source, file_bytes, spool, host).await;
    if let Err(error) = source.close().await {
        tracing::debug!(%error, "closing the quarantined spool failed");
    }
    if result.is_err() {
        remove_incomplete_spool(spool);
    }
    result
}

/// Removes an incomplete new spool.
fn remove_incomplete_spool(spool: &Path) {
    for suffix in ["-wal", "-shm", ""] {
        match fs::remove_file(with_suffix(spool, suffix)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::warn!(%error, "cannot remove {}, an incomplete copy of a damaged spool", spool.display());
            }
            _ => {}
        }
    }
}

/// Creates the new spool, if the damaged spool belongs to `host`.
async fn create(
    source: &mut SqliteConnection,
    file_bytes: u64,
    spool: &Path,
    host: HostId,
) -> Result<RecoveryCounts, RecoveryError> {
    let owner: Option<String> =
        sqlx::query_scalar("SELECT host FROM stream WHERE id = 1").fetch_optional(&mut *source).await?;
    if owner != Some(host.to_string()) {
        return Err(RecoveryError::OtherHost);
    }
    let mut target = settings(spool).connect().await?;
    let result = fill(source, &mut target, file_bytes, spool).await;
    // The connection is closed before the file is removed or opened again.
    target.close().await?;
    result
}

/// Copies the state and the intact batches to the new spool, in one transaction.
async fn fill(
    source: &mut SqliteConnection,
    target: &mut SqliteConnection,
    file_bytes: u64,
    spool: &Path,
) -> Result<RecoveryCounts, RecoveryError> {
    let cannot_create = |error: &dyn std::error::Error| RecoveryError::Create(error.to_string());
    set_application_id(spool, target).await.map_err(|error| cannot_create(&error))?;
    // `None` means up to the newest migration; with `true` the migrations would be recorded but not executed.
    MIGRATIONS.run_direct(None, target, false).await.map_err(|error| cannot_create(&error))?;
    sqlx::query("BEGIN IMMEDIATE").execute(&mut *target).await?;
    for table in STATE_TABLES {
        copy_table(source, target, table).await?;
    }
    let recovered = copy_batches(source, target, file_bytes).await?;
    count_losses(target, recovered.lost_events).await?;
    sqlx::query("COMMIT").execute(target).await?;
    Ok(recovered)
}

/// Copies all rows of a table. A spool of an earlier version has fewer columns; the missing columns get their default
/// values.
async fn copy_table(
    source: &mut SqliteConnection,
    target: &mut SqliteConnection,
    table: &str,
) -> Result<(), sqlx::Error> {
    let column_query = "SELECT name FROM pragma_table_info(?)";
    let source_columns: Vec<String> =
        sqlx::query_scalar(column_query).bind(table).fetch_all(&mut *source).await?;
    let target_columns: Vec<String> =
        sqlx::query_scalar(column_query).bind(table).fetch_all(&mut *target).await?;
    let shared_columns: Vec<&str> =
        target_columns.iter().filter(|name| source_columns.contains(name)).map(String::as_str).collect();
    if shared_columns.is_empty() {
        return Ok(());
    }
    // `quote()` of SQLite returns each value as an SQL literal. All names come from this program's own schema, so they
    // are safe in a statement.
    let literals: Vec<String> = shared_columns.iter().map(|name| format!("quote({name})")).collect();
    let select = format!("SELECT {} FROM {table}", literals.join(" || ',' || "));
    let rows: Vec<String> = sqlx::query_scalar(AssertSqlSafe(select)).fetch_all(source).await?;
    for row in rows {
        let insert = format!("INSERT INTO {table} ({}) VALUES ({row})", shared_columns.join(", "));
        sqlx::query(AssertSqlSafe(insert)).execute(&mut *target).await?;
    }
    Ok(())
}

/// Copies the batches before the first batch that cannot be read or does not match its chain hash.
async fn copy_batches(
    source: &mut SqliteConnection,
    target: &mut SqliteConnection,
    file_bytes: u64,
) -> Result<RecoveryCounts, RecoveryError> {
    let (acknowledged, first_chain): (i64, Vec<u8>) =
        sqlx::query_as("SELECT acknowledged, chain FROM stream WHERE id = 1").fetch_one(&mut *target).await?;
    let mut previous: ChainHash = chain_from_column(&first_chain).map_err(|_| RecoveryError::NoBatch)?;
    let mut recovered = RecoveryCounts::default();
    let mut number = acknowledged;
    loop {
        number = number.saturating_add(1);
        let row = sqlx::query_as("SELECT since_ns, events, chain, body FROM batch WHERE number = ?")
            .bind(number)
            .fetch_optional(&mut *source)
            .await;
        let row: (i64, u32, Vec<u8>, Vec<u8>) = match row {
            Ok(Some(row)) => row,
            Ok(None) => break,
            Err(error) if is_corrupt(&error) || matches!(error, sqlx::Error::ColumnDecode { .. }) => break,
            Err(error) => return Err(error.into()),
        };
        let (since_ns, events, stored_chain, body) = row;
        let expected = previous.next(events, &body);
        if stored_chain != expected.as_bytes() {
            break;
        }
        sqlx::query("INSERT INTO batch (number, since_ns, events, chain, body) VALUES (?, ?, ?, ?, ?)")
            .bind(number)
            .bind(since_ns)
            .bind(events)
            .bind(stored_chain)
            .bind(body)
            .execute(&mut *target)
            .await?;
        previous = expected;
        recovered.batches += 1;
        recovered.events += u64::from(events);
    }
    if recovered.batches == 0 {
        return Err(RecoveryError::NoBatch);
    }
    // The loop ended at the first batch that was not copied.
    let first_lost = number;
    let newest: Result<Option<i64>, _> =
        sqlx::query_scalar("SELECT MAX(number) FROM batch").fetch_one(&mut *source).await;
    let lost =
        newest.ok().flatten().map(|newest| newest.saturating_sub(first_lost - 1).max(0).cast_unsigned());
    recovered.lost_batches = lost.filter(|lost| *lost <= file_bytes / MIN_BATCH_BYTES);
    for lost_number in (first_lost..).take(recovered.lost_batches.unwrap_or(0) as usize) {
        let events: Result<Option<u32>, _> = sqlx::query_scalar("SELECT events FROM batch WHERE number = ?")
            .bind(lost_number)
            .fetch_optional(&mut *source)
            .await;
        // A row on a damaged page has no known number of events.
        recovered.lost_events += events.ok().flatten().map_or(0, u64::from);
    }
    Ok(recovered)
}

/// Counts the events of lost batches as dropped, so that they do not count as stored. The events also count as
/// reported, because an incident reports them and no gap must report them again. The counts stay as
/// they are if losses of earlier processes are not reported yet, because the tables of these losses contain values of
/// the column `told`. The counts also stay if more events would count as dropped than as produced.
async fn count_losses(target: &mut SqliteConnection, lost_events: u64) -> Result<(), sqlx::Error> {
    sqlx::query(
        "UPDATE stream SET dropped = dropped + ?1, told = told + ?1
         WHERE id = 1 AND NOT EXISTS (SELECT 1 FROM unreported) AND NOT EXISTS (SELECT 1 FROM unresolved)
           AND produced >= dropped + ?1",
    )
    .bind(lost_events.cast_signed())
    .execute(target)
    .await
    .map(drop)
}
