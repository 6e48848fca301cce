//! Ends of runs that were not reported: the agent was killed, or the report was lost.

use sqlx::SqliteConnection;

use super::Refusal;

/// Reason of an end that was not reported. It is stored and compared, so the text must never change. It is also used if
/// a new run of a pipeline shows that the previous run has ended, although the agent may still be running then.
///
/// Iterations of the run that arrive later move this end. A reported end that arrives later replaces it.
pub(super) const UNREPORTED_END: &str = "the agent ended without saying so";

/// Ends of runs that follow from the events of a transaction. They are written at the end of the transaction, after the
/// last iterations are counted.
#[derive(Debug, Default)]
pub(super) struct RunEnds {
    /// Hosts whose process ended, with the newest run that may belong to that process.
    processes: Vec<(i64, i64)>,
    /// Pipelines with a new run, with the number of the run.
    pipelines: Vec<(i64, i64)>,
}

impl RunEnds {
    /// Records the process with which a host introduced itself. If it differs from the host's previous process, the
    /// runs of the previous process have ended.
    pub(super) async fn record_process(
        &mut self,
        connection: &mut SqliteConnection,
        host: i64,
        process: u64,
    ) -> Result<(), Refusal> {
        // SQLite's integers are signed, so the same bits are stored as a signed number.
        let process = process.cast_signed();
        let previous_process: Option<i64> = sqlx::query_scalar("SELECT process FROM host WHERE id = ?")
            .bind(host)
            .fetch_one(&mut *connection)
            .await?;
        if previous_process == Some(process) {
            return Ok(());
        }
        if previous_process.is_some() {
            self.record_process_end(connection, host).await?;
        }
        sqlx::query("UPDATE host SET process = ? WHERE id = ?")
            .bind(process)
            .bind(host)
            .execute(connection)
            .await?;
        Ok(())
    }

    /// Records that the process of a host has ended, so the host's runs that are stored so far have ended, too.
    pub(super) async fn record_process_end(
        &mut self,
        connection: &mut SqliteConnection,
        host: i64,
    ) -> Result<(), Refusal> {
        // Runs that the host's next process starts in the same transaction have greater numbers and stay open.
        let newest =
            sqlx::query_scalar("SELECT coalesce(max(number), 0) FROM run").fetch_one(connection).await?;
        self.processes.push((host, newest));
        Ok(())
    }

    /// Records that a run of a pipeline started, so the pipeline's earlier runs have ended.
    pub(super) fn record_next_run(&mut self, pipeline: i64, run: i64) {
        self.pipelines.push((pipeline, run));
    }

    /// Ends the recorded runs that are still open.
    pub(super) async fn write(&mut self, connection: &mut SqliteConnection) -> Result<(), Refusal> {
        for (host, newest) in self.processes.drain(..) {
            sqlx::query(
                "UPDATE run SET ended_ns = coalesce(last_iteration_ns, started_ns), end_reason = ?1 \
                 WHERE pipeline IN (SELECT id FROM pipeline WHERE host = ?2) AND ended_ns IS NULL AND number <= ?3",
            )
            .bind(UNREPORTED_END)
            .bind(host)
            .bind(newest)
            .execute(&mut *connection)
            .await?;
        }
        for (pipeline, run) in self.pipelines.drain(..) {
            sqlx::query(
                "UPDATE run SET ended_ns = coalesce(last_iteration_ns, started_ns), end_reason = ?1 \
                 WHERE pipeline = ?2 AND ended_ns IS NULL AND number < ?3",
            )
            .bind(UNREPORTED_END)
            .bind(pipeline)
            .bind(run)
            .execute(&mut *connection)
            .await?;
        }
        Ok(())
    }

    /// Discards the state that is only in memory, because the transaction failed.
    pub(super) fn forget(&mut self) {
        self.processes.clear();
        self.pipelines.clear();
    }
}
