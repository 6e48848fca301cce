//! Rebuilding of roll-ups from the nodes, and of coarser roll-ups from finer roll-ups. No other process may write
//! meanwhile.

mod coarser;
mod nodes;

use sqlx::{Connection, SqliteConnection};

pub(crate) use self::coarser::build_missing_rollups;
use crate::retention::{Kind, begin_retention_period};
use crate::rollups::{Rollups, Scope, WHOLE_RUN, WIDTHS_S};

/// Progress of a rebuild.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rebuilt {
    /// Number of runs whose rebuild is complete.
    pub runs: u64,
    /// Number of successful iterations that were read, without the warm-up.
    pub iterations: u64,
    /// Number of runs that were rebuilt in part, because retention has deleted nodes. The statistics of such a run over
    /// the whole run are unchanged, and so are its buckets with deleted nodes.
    pub partly_rebuilt_runs: u64,
}

/// Selects the run that follows another run: ?1 the other run.
const NEXT_RUN: &str = "SELECT min(number) FROM run WHERE number > ?1";
/// Selects the second before which the nodes (kind 0) of a run are deleted: ?1 run.
const FIRST_COMPLETE_SECOND: &str = "SELECT before_s FROM trimmed WHERE run = ?1 AND kind = 0";
/// Counts the skipped starts of a run in the same way as the migration that added the column: ?1 run. Skipped starts
/// before answered iterations are in the roll-up of the whole run. Skipped starts before unanswered iterations are read
/// from the nodes. The limit is the writer's limit, 2^53.
const SKIPPED_STARTS: &str = "UPDATE run SET skipped_starts = CAST(coalesce(max(0.0, min(9007199254740992.0, round( \
     (SELECT total(rollup.count * rollup.mean) FROM rollup \
     WHERE rollup.run = run.number AND rollup.resolution_s = 0 AND rollup.bucket_s = 0 AND rollup.quantity = 0 \
     AND rollup.name IN (SELECT id FROM name WHERE text = 'skipped-starts')) \
     + (SELECT total(node.value) FROM iteration INDEXED BY iteration_without_answer \
     CROSS JOIN node ON node.run = iteration.run AND node.iteration = iteration.number \
     WHERE iteration.run = run.number AND iteration.outcome <> 0 AND iteration.warm_up = 0 \
     AND node.value > 0 AND node.name IN (SELECT id FROM name WHERE text = 'skipped-starts')) \
     ))), 0.0) AS INTEGER) \
     WHERE number = ?1";

/// Makes the roll-ups of a run, or of all runs, from the nodes that still exist.
///
/// Each run has its own transaction, so a run has either its old statistics or its new statistics. `progress` is called
/// after every few hundred iterations, and after each run.
///
/// # Errors
/// When the database cannot be read or written. Runs whose rebuild is complete keep their new statistics.
pub(crate) async fn rebuild(
    connection: &mut SqliteConnection,
    run: Option<i64>,
    mut progress: impl FnMut(&Rebuilt),
) -> Result<Rebuilt, sqlx::Error> {
    let mut rebuilt = Rebuilt::default();
    let mut previous = run.map_or(i64::MIN, |run| run - 1);
    loop {
        let next: Option<i64> =
            sqlx::query_scalar(NEXT_RUN).bind(previous).fetch_one(&mut *connection).await?;
        let Some(next) = next.filter(|next| run.is_none_or(|run| run == *next)) else {
            return Ok(rebuilt);
        };
        // Dropping the transaction rolls it back.
        let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
        rebuild_run(&mut transaction, next, &mut rebuilt, &mut progress).await?;
        transaction.commit().await?;
        rebuilt.runs += 1;
        progress(&rebuilt);
        previous = next;
    }
}

async fn rebuild_run(
    connection: &mut SqliteConnection,
    run: i64,
    rebuilt: &mut Rebuilt,
    progress: &mut impl FnMut(&Rebuilt),
) -> Result<(), sqlx::Error> {
    let first_complete_s: Option<i64> =
        sqlx::query_scalar(FIRST_COMPLETE_SECOND).bind(run).fetch_optional(&mut *connection).await?;
    let scope = first_complete_s.map_or(Scope::All, Scope::From);
    for width_s in WIDTHS_S {
        sqlx::query("DELETE FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s >= ?3")
            .bind(run)
            .bind(width_s)
            .bind(first_complete_s.unwrap_or(i64::MIN))
            .execute(&mut *connection)
            .await?;
    }
    if first_complete_s.is_none() {
        sqlx::query("DELETE FROM rollup WHERE run = ?1 AND resolution_s = ?2")
            .bind(run)
            .bind(WHOLE_RUN)
            .execute(&mut *connection)
            .await?;
        sqlx::query("DELETE FROM verdict_count WHERE run = ?").bind(run).execute(&mut *connection).await?;
    } else {
        rebuilt.partly_rebuilt_runs += 1;
    }
    let mut rollups = Rollups::with_scope(scope);
    nodes::write_rollups(connection, run, first_complete_s, &mut rollups, |iterations| {
        rebuilt.iterations += iterations;
        progress(rebuilt);
    })
    .await?;
    // If nodes are deleted, the skipped starts that these nodes reported cannot be counted again.
    if first_complete_s.is_none() {
        sqlx::query(SKIPPED_STARTS).bind(run).execute(&mut *connection).await?;
    }
    record_rebuilt(connection, run, first_complete_s).await
}

/// Records that the rebuilt buckets exist again, and starts their retention periods.
async fn record_rebuilt(
    connection: &mut SqliteConnection,
    run: i64,
    first_complete_s: Option<i64>,
) -> Result<(), sqlx::Error> {
    for width_s in WIDTHS_S {
        match first_complete_s {
            None => sqlx::query("DELETE FROM trimmed WHERE run = ?1 AND kind = ?2").bind(run).bind(width_s),
            Some(first_complete_s) => {
                // The start of the first bucket with all its nodes.
                let rounded_up = first_complete_s.saturating_add(width_s - 1);
                sqlx::query("UPDATE trimmed SET before_s = min(before_s, ?3) WHERE run = ?1 AND kind = ?2")
                    .bind(run)
                    .bind(width_s)
                    .bind(rounded_up - rounded_up.rem_euclid(width_s))
            }
        }
        .execute(&mut *connection)
        .await?;
        begin_retention_period(connection, Kind::Buckets(width_s), run).await?;
    }
    Ok(())
}

/// Statements of a rebuild, whose query plans a test checks.
#[cfg(test)]
pub(crate) const QUERIES: [(&str, &str); 6] = [
    ("NEXT_RUN", NEXT_RUN),
    ("FIRST_COMPLETE_SECOND", FIRST_COMPLETE_SECOND),
    ("SKIPPED_STARTS", SKIPPED_STARTS),
    ("PAGE", nodes::PAGE),
    ("NODES", nodes::NODES),
    ("TEN_SECOND_BUCKETS", coarser::TEN_SECOND_BUCKETS),
];
