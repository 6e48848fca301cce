//! The limit of the database's size.

use peernet_clock::{MonoTime, Span, WallTime};
use sqlx::SqliteConnection;

use super::Kind;
use super::arrivals::{self, TrimResult};
use super::deletions::{Cause, Deletion};
use crate::column::{column, count};

/// Kinds of data that may be deleted because of the size, in the order of their deletion. Clock samples and statistics
/// of hours and whole runs are never deleted because of the size.
const DELETION_ORDER: [Kind; 4] = [Kind::Nodes, Kind::Buckets(1), Kind::Buckets(10), Kind::Buckets(60)];
/// Pause after a step in which no data was left that may be deleted.
const PAUSE: Span = Span::from_seconds(60);

/// Number of bytes in use. Free pages do not count, because SQLite uses them again before the file grows.
const USED_BYTES: &str = "SELECT (page_count - freelist_count) * page_size \
     FROM pragma_page_count, pragma_freelist_count, pragma_page_size";

/// The limit of the bytes that the database uses.
#[derive(Debug)]
pub(super) struct SizeLimit {
    /// The limit in bytes; 0 for none.
    limit: u64,
    /// `true` after the log line that data is deleted because of the limit. The line is written once.
    is_reported: bool,
    /// `true` after the log line that no more data may be deleted. The line is written once.
    is_end_reported: bool,
    /// Time at which no data was left that may be deleted.
    nothing_left_at: Option<MonoTime>,
}

impl SizeLimit {
    pub(super) const fn new(limit: u64) -> Self {
        Self { limit, is_reported: false, is_end_reported: false, nothing_left_at: None }
    }

    /// Returns whether data has to be deleted now.
    pub(super) async fn is_exceeded(
        &self,
        connection: &mut SqliteConnection,
        now: MonoTime,
    ) -> Result<bool, sqlx::Error> {
        let is_paused = self.nothing_left_at.is_some_and(|at| now - at < PAUSE);
        Ok(self.limit > 0 && !is_paused && used_bytes(connection).await? > self.limit)
    }

    /// Deletes data of runs that are not pinned. All data of a kind is deleted before data of the next kind in
    /// [`DELETION_ORDER`]. The data that arrived first is deleted first, at any age. Returns `false` if no such data
    /// remained.
    pub(super) async fn reduce(
        &mut self,
        connection: &mut SqliteConnection,
        (now_s, now): (i64, WallTime),
        max_cost: u64,
        deletions: &mut Vec<Deletion>,
    ) -> Result<bool, sqlx::Error> {
        for kind in DELETION_ORDER {
            let earlier_deletions = deletions.len();
            let TrimResult { cost, is_complete } =
                arrivals::trim(connection, (kind, Cause::Size), i64::MAX, now_s, max_cost, deletions).await?;
            if cost > 0 {
                if !self.is_reported {
                    tracing::warn!(
                        limit_bytes = self.limit,
                        "the database is at [aggregator.retention] size_limit_bytes: the oldest data is deleted before \
                         the end of its period; raise the limit, or shorten the periods"
                    );
                    self.is_reported = true;
                }
                self.nothing_left_at = None;
                let items: u64 =
                    deletions.iter().skip(earlier_deletions).map(|deletion| deletion.items).sum();
                record_early_deletion(connection, now, items).await?;
                return Ok(true);
            }
            // This transaction removed only rows of the table `arrival` whose data was deleted already, and stopped at
            // the limit of rows. Other rows of this kind may still refer to stored data.
            if !is_complete {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Logs that no more data may be deleted, and pauses.
    pub(super) fn give_up(&mut self, now: MonoTime) {
        if !self.is_end_reported {
            tracing::warn!(
                limit_bytes = self.limit,
                "the database is above [aggregator.retention] size_limit_bytes, and no more data may be deleted: \
                 the remaining data are pinned runs, clock samples, and statistics of hours and whole runs; unpin runs, \
                 shorten clock_samples_days, or raise the limit"
            );
            self.is_end_reported = true;
        }
        self.nothing_left_at = Some(now);
    }
}

/// Returns the bytes that the file uses, without free pages.
async fn used_bytes(connection: &mut SqliteConnection) -> Result<u64, sqlx::Error> {
    let bytes: i64 = sqlx::query_scalar(USED_BYTES).fetch_one(connection).await?;
    Ok(count(bytes))
}

/// Records for `peernetd doctor` that data was deleted before the end of its retention period. `items` is the number of
/// deleted iterations or rows of statistics.
async fn record_early_deletion(
    connection: &mut SqliteConnection,
    now: WallTime,
    items: u64,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "INSERT INTO retention_note (what, first_ns, last_ns, count) VALUES ('size-limit', ?1, ?1, ?2) \
         ON CONFLICT DO UPDATE SET last_ns = excluded.last_ns, count = count + excluded.count",
    )
    .bind(now.unix_nanos())
    .bind(column(items))
    .execute(connection)
    .await?;
    Ok(())
}
