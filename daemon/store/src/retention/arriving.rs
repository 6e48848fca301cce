//! Conversion of recent arrivals to rows of the table `arrival`.
//!
//! In each transaction the writer records which iterations of a run and which samples of a link arrived (the columns
//! `arriving_*`). After a sixty-fourth of the shortest retention period, this record becomes a row of `arrival`, or
//! extends the newest row. Therefore each kind of data has few rows within its period.

use sqlx::{FromRow, SqliteConnection};

use super::{Kind, Periods};
use crate::extent::Extent;
use crate::rollups::bucket;

/// Whether any record of arriving data began at this second of the storage clock or before: ?1 second.
// The indexes contain only runs and links with such a record. With `INDEXED BY`, SQLite cannot choose to read all runs.
const ANY: &str = "SELECT EXISTS (SELECT 1 FROM run INDEXED BY run_arriving WHERE arriving_from_s <= ?1) \
     OR EXISTS (SELECT 1 FROM link INDEXED BY link_arriving WHERE arriving_from_s <= ?1)";
/// Runs whose record of arriving data began at this second or before: ?1 second, ?2 limit.
const RUNS: &str = "SELECT number, pinned, arriving_from_s AS from_s, arriving_first_number AS first_number, \
       arriving_last_number AS last_number, arriving_first_s AS first_s, arriving_last_s AS last_s \
     FROM run INDEXED BY run_arriving WHERE arriving_from_s <= ?1 ORDER BY arriving_from_s LIMIT ?2";
/// Links whose record of arriving data began at this second or before: ?1 second, ?2 limit.
const LINKS: &str = "SELECT id, arriving_from_s, arriving_first_ns, arriving_last_ns \
     FROM link INDEXED BY link_arriving WHERE arriving_from_s <= ?1 ORDER BY arriving_from_s LIMIT ?2";
/// Clears the record of a run: ?1 run.
const CLEAR_RUN: &str = "UPDATE run SET arriving_from_s = NULL, arriving_first_number = NULL, arriving_last_number = NULL, \
     arriving_first_s = NULL, arriving_last_s = NULL WHERE number = ?1";
/// Clears the record of a link: ?1 link.
const CLEAR_LINK: &str =
    "UPDATE link SET arriving_from_s = NULL, arriving_first_ns = NULL, arriving_last_ns = NULL WHERE id = ?1";
/// Extends the newest row of `arrival` if this row began after a given second: ?1 kind, ?2 owner, ?3 now, ?4 and ?5
/// first and last number of the range, ?6 the given second.
const EXTEND: &str = "UPDATE arrival SET to_s = max(to_s, ?3), first = min(first, ?4), last = max(last, ?5) \
     WHERE kind = ?1 AND owner = ?2 AND from_s > ?6 \
       AND from_s = (SELECT max(newest.from_s) FROM arrival AS newest WHERE newest.kind = ?1 AND newest.owner = ?2)";
/// Inserts a row of `arrival`: ?1 kind, ?2 owner, ?3 second at which the arrivals began, ?4 now, ?5 and ?6 first and
/// last number of the range. A row with this key may exist already: a row for all data that arrived
/// earlier has the second 0, and a new storage clock starts at 0.
const INSERT: &str = "INSERT INTO arrival (kind, owner, from_s, to_s, first, last) VALUES (?1, ?2, ?3, ?4, ?5, ?6) \
     ON CONFLICT (kind, owner, from_s) DO UPDATE SET to_s = max(to_s, excluded.to_s), \
     first = min(first, excluded.first), last = max(last, excluded.last)";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 7] = [
    ("ANY", ANY),
    ("RUNS", RUNS),
    ("LINKS", LINKS),
    ("CLEAR_RUN", CLEAR_RUN),
    ("CLEAR_LINK", CLEAR_LINK),
    ("EXTEND", EXTEND),
    ("INSERT", INSERT),
];

#[derive(FromRow)]
struct Run {
    number: i64,
    pinned: bool,
    from_s: i64,
    first_number: i64,
    last_number: i64,
    first_s: i64,
    last_s: i64,
}

/// Returns whether any record of arriving data began at `until_s` or before.
pub(super) async fn has_records(
    connection: &mut SqliteConnection,
    until_s: i64,
) -> Result<bool, sqlx::Error> {
    sqlx::query_scalar(ANY).bind(until_s).fetch_one(connection).await
}

/// Converts the records of arriving data that began at `until_s` or before: the records of up to `limit` runs and of up
/// to `limit` links. Returns the number of runs and links.
pub(super) async fn convert(
    connection: &mut SqliteConnection,
    periods: &Periods,
    until_s: i64,
    now_s: i64,
    limit: u32,
) -> Result<usize, sqlx::Error> {
    let runs: Vec<Run> = sqlx::query_as(RUNS).bind(until_s).bind(limit).fetch_all(&mut *connection).await?;
    for run in &runs {
        let numbers = Extent { first: run.first_number, last: run.last_number };
        for kind in Kind::OF_RUNS {
            let extent = match kind {
                Kind::Buckets(width_s) => {
                    Extent { first: bucket(run.first_s, width_s), last: bucket(run.last_s, width_s) }
                }
                _ => numbers,
            };
            // The retention periods of a pinned run begin when the run is unpinned.
            if !run.pinned {
                append(connection, periods, kind, run.number, (run.from_s, now_s), extent).await?;
            }
        }
        sqlx::query(CLEAR_RUN).bind(run.number).execute(&mut *connection).await?;
    }
    let links: Vec<(i64, i64, i64, i64)> =
        sqlx::query_as(LINKS).bind(until_s).bind(limit).fetch_all(&mut *connection).await?;
    for (link, from_s, first, last) in &links {
        let extent = Extent { first: *first, last: *last };
        append(connection, periods, Kind::ClockSamples, *link, (*from_s, now_s), extent).await?;
        sqlx::query(CLEAR_LINK).bind(link).execute(&mut *connection).await?;
    }
    Ok(runs.len() + links.len())
}

/// Extends the newest row of a kind and owner, or adds a row if the newest row began too long ago.
async fn append(
    connection: &mut SqliteConnection,
    periods: &Periods,
    kind: Kind,
    owner: i64,
    (from_s, now_s): (i64, i64),
    extent: Extent,
) -> Result<(), sqlx::Error> {
    let extension = sqlx::query(EXTEND)
        .bind(kind.number())
        .bind(owner)
        .bind(now_s)
        .bind(extent.first)
        .bind(extent.last)
        .bind(now_s - periods.resolution_s(kind))
        .execute(&mut *connection)
        .await?;
    if extension.rows_affected() == 0 {
        sqlx::query(INSERT)
            .bind(kind.number())
            .bind(owner)
            .bind(from_s)
            .bind(now_s)
            .bind(extent.first)
            .bind(extent.last)
            .execute(connection)
            .await?;
    }
    Ok(())
}
