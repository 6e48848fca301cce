//! Deletion of the clock samples of a link, together with the statistics of the link's connections from the same time.
//!
//! Samples from the time of a pinned run are not deleted if the run's edge is the link's edge. The delays of the run
//! can therefore be judged again.

use sqlx::SqliteConnection;

use super::DeletedRows;
use crate::column::column;
use crate::extent::Extent;

/// Time before and after a pinned run from which samples are not deleted.
const PINNED_MARGIN_NS: i64 = 3_600_000_000_000;
/// Cost of deleting a clock sample, in rows of the table `node`. A sample is several times as large as a row of `node`.
const SAMPLE_COST: u64 = 5;

/// Time of the first sample within a range of time: ?1 link, ?2 and ?3 first and last time of the range.
const OLDEST: &str = "SELECT min(at_ns) FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN ?2 AND ?3";
/// Starts and ends of the pinned runs of a link's edge: ?1 link.
const PINNED: &str = "SELECT run.started_ns, coalesce(max(run.ended_ns, run.last_iteration_ns), run.ended_ns, 9223372036854775807) \
     FROM run INDEXED BY run_pinned CROSS JOIN pipeline ON pipeline.id = run.pipeline \
     WHERE run.pinned = 1 AND pipeline.host = (SELECT edge FROM link WHERE id = ?1)";
/// Time of the sample that follows the first samples of the range. Parameters as in `OLDEST`, ?4 the number of these
/// first samples.
const AFTER: &str = "SELECT at_ns FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN ?2 AND ?3 \
     ORDER BY at_ns LIMIT 1 OFFSET ?4";
/// Deletes the samples within a range of time. Parameters as in `OLDEST`.
const DELETE: &str = "DELETE FROM clock_sample WHERE link = ?1 AND at_ns BETWEEN ?2 AND ?3";
/// Deletes the statistics of connections since the first deleted sample and before the sample that follows the last
/// deleted sample. Parameters as in `OLDEST`.
// The next sample may have arrived later, so the statistics between both samples are in no range of arrivals.
const CONNECTIONS: &str = "DELETE FROM connection_sample WHERE link = ?1 AND at_ns >= ?2 \
     AND at_ns < coalesce((SELECT min(at_ns) FROM clock_sample WHERE link = ?1 AND at_ns > ?3), 9223372036854775807)";
/// Deletes the relation periods that ended at a time or before and have no more samples. The newest relation period is
/// kept, because it may continue. ?1 link, ?2 time.
const RELATION_PERIODS: &str = "DELETE FROM clock_window WHERE link = ?1 AND last_ns <= ?2 \
     AND id <> (SELECT max(id) FROM clock_window WHERE link = ?1) \
     AND NOT EXISTS (SELECT 1 FROM clock_sample WHERE clock_sample.link = clock_window.link \
       AND clock_sample.at_ns BETWEEN clock_window.first_ns AND clock_window.last_ns \
       AND clock_sample.window = clock_window.window)";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 6] = [
    ("CLOCK_OLDEST", OLDEST),
    ("PINNED", PINNED),
    ("CLOCK_AFTER", AFTER),
    ("CLOCK_DELETE", DELETE),
    ("CONNECTIONS", CONNECTIONS),
    ("RELATION_PERIODS", RELATION_PERIODS),
];

/// Returns the times from which samples of a link are not deleted: the times of the pinned runs of the link's edge,
/// with margins.
pub(super) async fn pinned_times(
    connection: &mut SqliteConnection,
    link: i64,
) -> Result<Vec<Extent>, sqlx::Error> {
    let runs: Vec<(i64, i64)> = sqlx::query_as(PINNED).bind(link).fetch_all(connection).await?;
    let with_margins = |(start, end): (i64, i64)| Extent {
        first: start.saturating_sub(PINNED_MARGIN_NS),
        last: end.max(start).saturating_add(PINNED_MARGIN_NS),
    };
    Ok(runs.into_iter().map(with_margins).collect())
}

/// Returns whether the link has samples within a range of time.
pub(super) async fn has_samples(
    connection: &mut SqliteConnection,
    link: i64,
    times: Extent,
) -> Result<bool, sqlx::Error> {
    let oldest = sqlx::query_scalar(OLDEST).bind(link).bind(times.first).bind(times.last);
    let oldest: Option<i64> = oldest.fetch_one(connection).await?;
    Ok(oldest.is_some())
}

/// Deletes the samples within a range of time, the first sample first, at a cost of about `max_cost` rows of the table
/// `node`.
pub(super) async fn delete(
    connection: &mut SqliteConnection,
    link: i64,
    times: Extent,
    max_cost: u64,
) -> Result<DeletedRows, sqlx::Error> {
    let first: Option<i64> = sqlx::query_scalar(OLDEST)
        .bind(link)
        .bind(times.first)
        .bind(times.last)
        .fetch_one(&mut *connection)
        .await?;
    let Some(first) = first else { return Ok(DeletedRows { is_complete: true, ..DeletedRows::default() }) };
    let next_time: Option<i64> = sqlx::query_scalar(AFTER)
        .bind(link)
        .bind(first)
        .bind(times.last)
        .bind(column((max_cost / SAMPLE_COST).max(1)))
        .fetch_optional(&mut *connection)
        .await?;
    // Samples with the same time may belong to different relation periods. They are deleted together.
    let through = next_time.map_or(times.last, |next_time| (next_time - 1).max(first));
    let deletion = sqlx::query(DELETE).bind(link).bind(first).bind(through);
    let items = deletion.execute(&mut *connection).await?.rows_affected();
    sqlx::query(CONNECTIONS).bind(link).bind(first).bind(through).execute(&mut *connection).await?;
    sqlx::query(RELATION_PERIODS).bind(link).bind(through).execute(connection).await?;
    Ok(DeletedRows { cost: items * SAMPLE_COST, items, is_complete: next_time.is_none() })
}
