//! Deletion of the roll-ups of one width of a run.

use sqlx::SqliteConnection;

use super::trimmed::record_trimmed;
use super::{DeletedRows, Kind};
use crate::column::column;
use crate::extent::Extent;

/// Cost of deleting a row of the table `rollup`, in rows of the table `node`. A row of `rollup` is several times as
/// large as a row of `node`.
const BUCKET_COST: u64 = 3;

/// The first bucket within a range of time: ?1 run, ?2 width, ?3 and ?4 first and last second of the range.
const OLDEST: &str =
    "SELECT min(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s BETWEEN ?3 AND ?4";
/// The last bucket within a range of time. Parameters as in `OLDEST`.
// This is a separate statement: SQLite looks up one end of a key per statement, and a statement with both min() and
// max() would read all rows of the range.
const LAST: &str =
    "SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s BETWEEN ?3 AND ?4";
/// The bucket of the row that follows the first rows of the range. Parameters as in `OLDEST`, ?5 the number of these
/// first rows.
const AFTER: &str = "SELECT bucket_s FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s BETWEEN ?3 AND ?4 \
     ORDER BY bucket_s LIMIT 1 OFFSET ?5";
/// Deletes the buckets within a range of time. Parameters as in `OLDEST`.
const DELETE: &str = "DELETE FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s BETWEEN ?3 AND ?4";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 4] =
    [("OLDEST", OLDEST), ("LAST", LAST), ("AFTER", AFTER), ("DELETE", DELETE)];

/// Deletes the buckets within a range of time, the first bucket first, at a cost of about `max_cost` rows of the table
/// `node`.
pub(super) async fn delete(
    connection: &mut SqliteConnection,
    run: i64,
    width_s: i64,
    seconds: Extent,
    max_cost: u64,
) -> Result<DeletedRows, sqlx::Error> {
    // The closure has one result type for three statements: min() and max() return NULL if the
    // range has no bucket, and `AFTER` returns no row.
    let query = |statement| sqlx::query_scalar(statement).bind(run).bind(width_s);
    let first: Option<i64> =
        query(OLDEST).bind(seconds.first).bind(seconds.last).fetch_one(&mut *connection).await?;
    let Some(first) = first else { return Ok(DeletedRows { is_complete: true, ..DeletedRows::default() }) };
    let max_rows = column((max_cost / BUCKET_COST).max(1));
    let next_bucket: Option<Option<i64>> =
        query(AFTER).bind(first).bind(seconds.last).bind(max_rows).fetch_optional(&mut *connection).await?;
    let next_bucket = next_bucket.flatten();
    // A bucket is deleted as a whole, whatever its number of rows.
    let through = next_bucket.map_or(seconds.last, |next_bucket| (next_bucket - 1).max(first));
    let newest: Option<i64> = query(LAST).bind(first).bind(through).fetch_one(&mut *connection).await?;
    let deletion = sqlx::query(DELETE).bind(run).bind(width_s).bind(first).bind(through);
    let items = deletion.execute(&mut *connection).await?.rows_affected();
    let before_s = newest.unwrap_or(first).saturating_add(width_s);
    record_trimmed(connection, Kind::Buckets(width_s), run, before_s).await?;
    Ok(DeletedRows { cost: items * BUCKET_COST, items, is_complete: next_bucket.is_none() })
}
