//! Statistics per minute and hour for runs of earlier versions, whose coarsest buckets were those of ten seconds.
//!
//! SQL cannot merge quantile sketches. So the migration leaves a list of runs (the table `rollup_debt`), and this code
//! processes the list when the file is opened, before anything else reads or writes.

use sqlx::{Connection, SqliteConnection};

use crate::rollups::{RollupRow, Rollups, Scope, bucket};

/// Width of the coarsest buckets that earlier versions stored. The wider buckets are made from these buckets.
const STORED_WIDTH_S: i64 = 10;
const HOUR_S: i64 = 3600;
/// Number of runs between two log lines.
const RUNS_PER_LOG_LINE: u64 = 100;

/// The rows of buckets of ten seconds within a range: ?1 run, ?2 start, ?3 end.
pub(super) const TEN_SECOND_BUCKETS: &str = "SELECT run, resolution_s, bucket_s, name, quantity, count, mean, m2, min, max, sketch \
     FROM rollup WHERE run = ?1 AND resolution_s = 10 AND bucket_s >= ?2 AND bucket_s < ?3";

/// Makes the missing statistics. Each run has its own transaction, so that a call after an interruption continues with
/// the next run.
///
/// # Errors
/// When the database cannot be read or written.
pub(crate) async fn build_missing_rollups(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    let runs: i64 =
        sqlx::query_scalar("SELECT count(*) FROM rollup_debt").fetch_one(&mut *connection).await?;
    if runs == 0 {
        return Ok(());
    }
    tracing::info!(runs, "computing statistics per minute and hour for runs that an earlier version stored");
    for done in 1.. {
        let run: Option<i64> =
            sqlx::query_scalar("SELECT min(run) FROM rollup_debt").fetch_one(&mut *connection).await?;
        let Some(run) = run else { break };
        // Dropping the transaction rolls it back.
        let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
        build_coarser_rollups(&mut transaction, run).await?;
        transaction.commit().await?;
        if done % RUNS_PER_LOG_LINE == 0 {
            tracing::info!(done, runs, "computing statistics per minute and hour");
        }
    }
    tracing::info!(runs, "computed statistics per minute and hour");
    Ok(())
}

async fn build_coarser_rollups(connection: &mut SqliteConnection, run: i64) -> Result<(), sqlx::Error> {
    sqlx::query("DELETE FROM rollup WHERE run = ? AND resolution_s IN (60, 3600)")
        .bind(run)
        .execute(&mut *connection)
        .await?;
    let mut rollups = Rollups::with_scope(Scope::Coarser);
    let mut from = i64::MIN;
    loop {
        let first: Option<i64> = sqlx::query_scalar(
            "SELECT min(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s >= ?3",
        )
        .bind(run)
        .bind(STORED_WIDTH_S)
        .bind(from)
        .fetch_one(&mut *connection)
        .await?;
        let Some(first) = first else { break };
        // The buckets of one hour are read at a time, which limits the memory.
        from = bucket(first, HOUR_S).saturating_add(HOUR_S);
        let rows: Vec<RollupRow> = sqlx::query_as(TEN_SECOND_BUCKETS)
            .bind(run)
            .bind(first)
            .bind(from)
            .fetch_all(&mut *connection)
            .await?;
        for row in rows {
            rollups.merge(run, row.name, row.quantity()?, row.bucket_s, &row.summary()?);
        }
        rollups.write(connection).await?;
    }
    sqlx::query("DELETE FROM rollup_debt WHERE run = ?").bind(run).execute(connection).await?;
    Ok(())
}
