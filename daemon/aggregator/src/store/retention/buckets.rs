//! The oldest roll-ups of a run and width.

use sqlx::SqliteConnection;

use super::trimmed::trimmed;
use super::{Deleted, Kind};
use crate::store::column::column;

/// What a row costs, in nodes: it is some times as long.
const ROW: u64 = 3;

/// The oldest bucket: ?1 run, ?2 width.
const OLDEST: &str = "SELECT min(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = ?2";
/// The last bucket before an end: ?1 run, ?2 width, ?3 end.
const LAST: &str = "SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s < ?3";
/// The bucket after so many rows: ?1 run, ?2 width, ?3 end, ?4 rows.
const AFTER: &str = "SELECT bucket_s FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s < ?3 \
     ORDER BY bucket_s LIMIT 1 OFFSET ?4";
/// ?1 run, ?2 width, ?3 end.
const DELETE: &str = "DELETE FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s < ?3";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 4] =
    [("OLDEST", OLDEST), ("LAST", LAST), ("AFTER", AFTER), ("DELETE", DELETE)];

/// Deletes buckets that begin before a second, oldest first, of about so many rows.
pub(super) async fn delete(
    connection: &mut SqliteConnection,
    run: i64,
    width_s: i64,
    end_s: i64,
    rows: u64,
) -> Result<Deleted, sqlx::Error> {
    let oldest = async |connection: &mut SqliteConnection| -> Result<Option<i64>, sqlx::Error> {
        sqlx::query_scalar(OLDEST).bind(run).bind(width_s).fetch_one(connection).await
    };
    let first = match oldest(connection).await? {
        Some(first) if first < end_s => first,
        left_s => return Ok(Deleted { rows: 0, left_s }),
    };
    let most = column((rows / ROW).max(1));
    let after: Option<i64> = sqlx::query_scalar(AFTER)
        .bind(run)
        .bind(width_s)
        .bind(end_s)
        .bind(most)
        .fetch_optional(&mut *connection)
        .await?;
    let through_s = match after {
        // A bucket goes whole, however many rows it has.
        Some(after) => after.max(first.saturating_add(1)),
        None => {
            let last = sqlx::query_scalar(LAST).bind(run).bind(width_s).bind(end_s);
            let last: Option<i64> = last.fetch_one(&mut *connection).await?;
            last.map_or(end_s, |last| last.saturating_add(width_s))
        }
    };
    let gone = sqlx::query(DELETE).bind(run).bind(width_s).bind(through_s.min(end_s));
    let gone = gone.execute(&mut *connection).await?.rows_affected() * ROW;
    trimmed(connection, Kind::Buckets(width_s), run, through_s).await?;
    Ok(Deleted { rows: gone, left_s: oldest(connection).await? })
}
