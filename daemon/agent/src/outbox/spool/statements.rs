//! The SQL statements that change the spool file.

use peernet_clock::WallTime;
use peernet_stream::{ChainHash, SpooledBatch, Totals};
use sqlx::SqliteConnection;

use super::killed_process;

/// Maximum number of processes for which the newest batch that they were allowed to send is recorded. Each start of the
/// agent is a process.
// The limit keeps the table small even if the agent restarts again and again without an aggregator.
pub(super) const MAX_PROCESSES: i64 = 64;

/// Number of unused pages that are kept for the next batches: 8 MiB.
const SPARE_PAGES: i64 = 2048;

/// Starts a transaction that inserts these batches and updates the totals. The caller ends the transaction.
/// `counts_events` is `true` if the process counts the events that it queues.
// `OR REPLACE` is needed if a commit seemed to fail but succeeded: the same batches are then inserted again.
pub(super) async fn insert(
    connection: &mut SqliteConnection,
    batches: &[SpooledBatch],
    totals: &Totals,
    counts_events: bool,
) -> Result<(), sqlx::Error> {
    begin(connection).await?;
    for batch in batches {
        sqlx::query(
            "INSERT OR REPLACE INTO batch (number, since_ns, events, chain, body) VALUES (?, ?, ?, ?, ?)",
        )
        .bind(batch.number.cast_signed())
        .bind(batch.since.unix_nanos())
        .bind(batch.events)
        .bind(batch.chain.as_bytes().as_slice())
        .bind(batch.body.as_ref())
        .execute(&mut *connection)
        .await?;
    }
    let settled_events = counts_events.then(|| totals.submitted.settled());
    sqlx::query(
        "UPDATE stream SET produced = ?, dropped = ?, gaps = ?, told = ?, counted = coalesce(?, counted), \
         taken = coalesce(?, taken), counted_ns = coalesce(?, counted_ns) WHERE id = 1",
    )
    .bind(totals.produced.cast_signed())
    .bind(totals.dropped.cast_signed())
    .bind(totals.gaps.cast_signed())
    .bind(totals.reported_drops.cast_signed())
    .bind(settled_events.as_ref().map(|settled_events| killed_process::encode_counts(&settled_events.events)))
    .bind(settled_events.as_ref().map(|settled_events| settled_events.batched.cast_signed()))
    .bind(settled_events.and_then(|settled_events| settled_events.last).map(WallTime::unix_nanos))
    .execute(&mut *connection)
    .await?;
    sqlx::query("DELETE FROM unreported WHERE told_through <= ?")
        .bind(totals.reported_drops.cast_signed())
        .execute(&mut *connection)
        .await?;
    // `unreported` is set if it is known which batches of the earlier process the aggregator has stored.
    if let Some(unreported) = &totals.unreported {
        killed_process::resolve(connection, totals.reported_drops, unreported).await?;
    }
    let Some(newest_sendable) = totals.newest_sendable else { return Ok(()) };
    sqlx::query("INSERT OR REPLACE INTO reached (process, number) VALUES (?, ?)")
        .bind(newest_sendable.process.cast_signed())
        .bind(newest_sendable.number.cast_signed())
        .execute(connection)
        .await
        .map(drop)
}

/// Starts a transaction that deletes the batches up to number `through`. The caller ends the transaction.
pub(super) async fn delete(
    connection: &mut SqliteConnection,
    through: u64,
    chain: ChainHash,
) -> Result<(), sqlx::Error> {
    begin(connection).await?;
    sqlx::query("DELETE FROM batch WHERE number <= ?")
        .bind(through.cast_signed())
        .execute(&mut *connection)
        .await?;
    sqlx::query("UPDATE stream SET acknowledged = ?, chain = ? WHERE id = 1")
        .bind(through.cast_signed())
        .bind(chain.as_bytes().as_slice())
        .execute(&mut *connection)
        .await?;
    sqlx::query(
        "DELETE FROM reached WHERE process NOT IN (SELECT process FROM reached ORDER BY number DESC LIMIT ?)",
    )
    .bind(MAX_PROCESSES)
    .execute(connection)
    .await
    .map(drop)
}

async fn begin(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    sqlx::query("BEGIN IMMEDIATE").execute(connection).await.map(drop)
}

/// Gives some unused pages back to the file system if the unused pages outnumber the used pages by more than
/// [`SPARE_PAGES`]. Returns whether another call may give back further pages.
///
/// With fewer unused pages, SQLite would have to move many used pages from the end of the file, and the next batches
/// would need the space again.
pub(super) async fn vacuum(connection: &mut SqliteConnection) -> Result<bool, sqlx::Error> {
    let (unused_pages, all_pages) = count_pages(connection).await?;
    if unused_pages <= all_pages - unused_pages + SPARE_PAGES {
        return Ok(false);
    }
    vacuum_step(connection).await?;
    Ok(true)
}

/// Returns all unused pages and the write-ahead log to the file system.
pub(super) async fn vacuum_all(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    while count_pages(connection).await?.0 > 0 {
        vacuum_step(connection).await?;
        checkpoint(connection).await?;
    }
    checkpoint(connection).await
}

/// Moves the write-ahead log to the file, and truncates it.
pub(super) async fn checkpoint(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(connection).await.map(drop)
}

/// Returns the numbers of unused pages and of all pages.
async fn count_pages(connection: &mut SqliteConnection) -> Result<(i64, i64), sqlx::Error> {
    sqlx::query_as("SELECT freelist_count, page_count FROM pragma_freelist_count(), pragma_page_count()")
        .fetch_one(connection)
        .await
}

/// Returns at most 1024 pages (4 MiB) to the file system, so that no request waits long.
async fn vacuum_step(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    sqlx::query("PRAGMA incremental_vacuum(1024)").execute(connection).await.map(drop)
}
