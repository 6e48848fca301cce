//! Deletion of roll-ups of a run and width.

use sqlx::SqliteConnection;

use super::trimmed::record_trimmed;
use super::{DeletedRows, Kind};
use crate::column::column;
use crate::extent::Extent;

/// Cost of deleting a row of the table `rollup`, in rows of the table `node`: it is several times as large.
const BUCKET_COST: u64 = 3;

/// The oldest bucket: ?1 run, ?2 width, ?3 and ?4 first and last.
const OLDEST: &str =
    "SELECT min(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s BETWEEN ?3 AND ?4";
/// The last bucket; parameters as above.
const LAST: &str =
    "SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s BETWEEN ?3 AND ?4";
/// The bucket after a number of rows; parameters as above, ?5 rows.
const AFTER: &str = "SELECT bucket_s FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s BETWEEN ?3 AND ?4 \
     ORDER BY bucket_s LIMIT 1 OFFSET ?5";
/// ?1 run, ?2 width, ?3 and ?4 first and last.
const DELETE: &str = "DELETE FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s BETWEEN ?3 AND ?4";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 4] =
    [("OLDEST", OLDEST), ("LAST", LAST), ("AFTER", AFTER), ("DELETE", DELETE)];

/// Deletes buckets by ascending start, at a cost of about `max_cost` rows of the table `node`.
pub(super) async fn delete(
    connection: &mut SqliteConnection,
    run: i64,
    width_s: i64,
    seconds: Extent,
    max_cost: u64,
) -> Result<DeletedRows, sqlx::Error> {
    let of = |statement| sqlx::query_scalar(statement).bind(run).bind(width_s);
    let first: Option<i64> =
        of(OLDEST).bind(seconds.first).bind(seconds.last).fetch_one(&mut *connection).await?;
    let Some(first) = first else { return Ok(DeletedRows { complete: true, ..DeletedRows::default() }) };
    let max_rows = column((max_cost / BUCKET_COST).max(1));
    let after: Option<Option<i64>> =
        of(AFTER).bind(first).bind(seconds.last).bind(max_rows).fetch_optional(&mut *connection).await?;
    let after = after.flatten();
    // A bucket is deleted as a whole, however many rows it has.
    let through = after.map_or(seconds.last, |after| (after - 1).max(first));
    let newest: Option<i64> = of(LAST).bind(first).bind(through).fetch_one(&mut *connection).await?;
    let gone = sqlx::query(DELETE).bind(run).bind(width_s).bind(first).bind(through);
    let items = gone.execute(&mut *connection).await?.rows_affected();
    let before_s = newest.unwrap_or(first).saturating_add(width_s);
    record_trimmed(connection, Kind::Buckets(width_s), run, before_s).await?;
    Ok(DeletedRows { cost: items * BUCKET_COST, items, complete: after.is_none() })
}
