//! Runs that ended without saying so: their agent was killed.

use sqlx::SqliteConnection;

use super::Refusal;

/// Reason of a run's end that nobody reported. When its last iterations come late they move its end; when its real
/// end comes it counts.
pub(super) const LEFT: &str = "the agent ended without saying so";

/// Ends that follow from what a transaction stores: written at its end, when the last iterations are counted.
#[derive(Debug, Default)]
pub(super) struct Ends {
    /// Hosts whose process ended, and the newest run that may be of it.
    processes: Vec<(i64, i64)>,
    /// Pipelines with a new run, and its number.
    pipelines: Vec<(i64, i64)>,
}

impl Ends {
    /// A process of a host introduced itself: the runs of another one before have ended.
    pub(super) async fn process(
        &mut self,
        connection: &mut SqliteConnection,
        host: i64,
        process: u64,
    ) -> Result<(), Refusal> {
        // SQLite's integers are signed: the bits are kept.
        let process = process.cast_signed();
        let before: Option<i64> = sqlx::query_scalar("SELECT process FROM host WHERE id = ?")
            .bind(host)
            .fetch_one(&mut *connection)
            .await?;
        if before == Some(process) {
            return Ok(());
        }
        if before.is_some() {
            self.left(connection, host).await?;
        }
        sqlx::query("UPDATE host SET process = ? WHERE id = ?")
            .bind(process)
            .bind(host)
            .execute(connection)
            .await?;
        Ok(())
    }

    /// The process of a host has ended: so have the runs that are known by now.
    pub(super) async fn left(&mut self, connection: &mut SqliteConnection, host: i64) -> Result<(), Refusal> {
        let newest =
            sqlx::query_scalar("SELECT coalesce(max(number), 0) FROM run").fetch_one(connection).await?;
        self.processes.push((host, newest));
        Ok(())
    }

    /// A run of a pipeline began: those before it have ended.
    pub(super) fn followed(&mut self, pipeline: i64, run: i64) {
        self.pipelines.push((pipeline, run));
    }

    /// Ends what is still open.
    pub(super) async fn write(&mut self, connection: &mut SqliteConnection) -> Result<(), Refusal> {
        for (host, newest) in self.processes.drain(..) {
            sqlx::query(
                "UPDATE run SET ended_ns = coalesce(last_iteration_ns, started_ns), end_reason = ?1 \
                 WHERE pipeline IN (SELECT id FROM pipeline WHERE host = ?2) AND ended_ns IS NULL AND number <= ?3",
            )
            .bind(LEFT)
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
            .bind(LEFT)
            .bind(pipeline)
            .bind(run)
            .execute(&mut *connection)
            .await?;
        }
        Ok(())
    }

    /// Forgets what is only in memory: the transaction did not end well.
    pub(super) fn forget(&mut self) {
        self.processes.clear();
        self.pipelines.clear();
    }
}
