//! Making salvaged rows agree with each other, and recording of lost iterations as gaps.

use std::collections::{BTreeMap, HashMap};

use sqlx::{AssertSqlSafe, FromRow, SqliteConnection};

use super::rows::{CopiedTable, UnreadableRange};
use crate::write::UNKNOWN;

/// Reason of the recorded gaps.
const REASON: &str = "the database was damaged, and its repair could not read these rows";

/// SQL expression for a random id.
const RANDOM_ID: &str = "lower(hex(randomblob(4)) || '-' || hex(randomblob(2)) || '-4' || substr(hex(randomblob(2)), 2) \
     || '-a' || substr(hex(randomblob(2)), 2) || '-' || hex(randomblob(6)))";

/// Tables with rows of an iteration's tree.
const TREES: [&str; 3] = ["node", "transit", "anchor"];

/// Rows that are deleted because they refer to lost rows: tables and conditions. An agent whose row in `stream` is lost
/// sends the events in its spool again, as after a restored backup.
const ORPHANS: [(&str, &str); 7] = [
    ("stream", "host NOT IN (SELECT id FROM host)"),
    ("quarantine", "host NOT IN (SELECT id FROM host)"),
    ("link", "edge NOT IN (SELECT id FROM host) OR cloud NOT IN (SELECT id FROM host)"),
    ("host_secret", "host NOT IN (SELECT id FROM host)"),
    ("clock_sample", "link NOT IN (SELECT id FROM link)"),
    ("clock_window", "link NOT IN (SELECT id FROM link)"),
    ("connection_sample", "link NOT IN (SELECT id FROM link)"),
];

/// Reconciliation of the salvaged tables with each other.
pub(super) struct Reconciliation<'a> {
    pub(super) connection: &'a mut SqliteConnection,
    pub(super) tables: &'a BTreeMap<String, CopiedTable>,
    pub(super) now_ns: i64,
}

/// A run with lost iterations.
#[derive(Debug, FromRow)]
struct IncompleteRun {
    number: i64,
    host: i64,
    pipeline: String,
    /// Earliest time of the lost iterations: the start of the iteration before the first missing number, or the start
    /// of the run if the run's first iteration is missing.
    gap_from_ns: i64,
    /// Latest time of the lost iterations: the start of the iteration after the last missing number, or the time of the
    /// run's last iteration if this iteration is missing.
    gap_to_ns: i64,
    /// Number of the last iteration that retention has deleted; 0 for none.
    last_deleted_iteration: i64,
    /// Number of iterations according to the run's counters.
    counted: i64,
    /// Number of iterations in the table.
    stored: i64,
    /// Number of missing iterations between the first iteration that retention left and the last iteration.
    missing_numbers: i64,
    /// Number of events in the gaps that the run already has.
    in_gaps: i64,
}

/// Statement that reads an [`IncompleteRun`]; ?1 is the number of the run. The first iteration has the number 1, or a
/// later number if retention has deleted iterations.
const RUN: &str = "SELECT run.number, pipeline.host, pipeline.name AS pipeline, run.nodes_from AS last_deleted_iteration, \
     run.warm_up + run.ok + run.failed + run.lost + run.timeout AS counted, \
     (SELECT count(*) FROM iteration WHERE run = ?1) AS stored, \
     (SELECT coalesce(max(number) - min(number) + 1 - count(*), 0) FROM iteration \
         WHERE run = ?1 AND number > run.nodes_from) AS missing_numbers, \
     (SELECT coalesce(sum(count), 0) FROM gap WHERE run = ?1) AS in_gaps, \
     coalesce((SELECT started_ns FROM iteration AS it WHERE run = ?1 AND NOT EXISTS \
         (SELECT 1 FROM iteration WHERE run = ?1 AND number = it.number + 1) \
         AND (SELECT min(number) FROM iteration WHERE run = ?1) <= run.nodes_from + 1 \
         ORDER BY number LIMIT 1), run.started_ns) AS gap_from_ns, \
     max(coalesce((SELECT started_ns FROM iteration AS it WHERE run = ?1 AND NOT EXISTS \
         (SELECT 1 FROM iteration WHERE run = ?1 AND number = it.number - 1) \
         AND (SELECT max(started_ns) FROM iteration WHERE run = ?1) >= run.last_iteration_ns \
         ORDER BY number DESC LIMIT 1), run.last_iteration_ns, run.started_ns), run.started_ns) AS gap_to_ns \
     FROM run JOIN pipeline ON pipeline.id = run.pipeline WHERE run.number = ?1";

impl Reconciliation<'_> {
    /// Reconciles all tables. Returns the number of lost iterations, as far as it can be determined.
    pub(super) async fn run(mut self) -> Result<i64, sqlx::Error> {
        if self.has_unreadable(&["host", "pipeline", "run", "link"]) {
            self.restore_references().await?;
            self.execute(
                "UPDATE host SET (gaps, missing) = (SELECT count(*), coalesce(sum(count), 0) FROM gap WHERE gap.host = host.id)",
            )
            .await?;
        }
        if self.has_unreadable(&["name"]) {
            self.restore_names().await?;
        }
        let mut lost = 0;
        // Trees with missing nodes are searched for even if all ranges could be read: a row with an overwritten key is
        // no unreadable range.
        let trees_with_missing_nodes = self.delete_trees_with_missing_nodes().await?;
        if trees_with_missing_nodes > 0
            || self.has_unreadable(&["iteration", "node", "transit", "anchor", "run"])
        {
            self.delete_incomplete_trees().await?;
            lost = self.record_gaps().await?;
        }
        if trees_with_missing_nodes > 0
            || self.has_unreadable(&["host", "pipeline", "run", "iteration", "node", "transit", "anchor"])
        {
            self.recount_nodes().await?;
        }
        if self.has_unreadable(&["arrival", "storage_clock", "retained", "run", "link"]) {
            self.restart_retention().await?;
        }
        Ok(lost)
    }

    /// Restarts the retention period of rows whose arrival time is lost, as if these rows had just arrived.
    // The numbers of `kind` in the statements are those of `retention::Kind`: 0 for nodes, the width for roll-ups, -1
    // for clock samples.
    async fn restart_retention(&mut self) -> Result<(), sqlx::Error> {
        if self.tables.contains_key("retained") {
            self.execute(
                "INSERT OR IGNORE INTO retained (kind, run) \
                 SELECT kind.column1, run.number FROM (VALUES (0), (1), (10), (60), (3600)) AS kind, run WHERE run.pinned = 0",
            )
            .await?;
        }
        if self.tables.contains_key("arrival") {
            // The storage clock must not fall behind a reading that is stored in another table.
            self.execute(
                "UPDATE storage_clock SET elapsed_ns = max(elapsed_ns, 1000000000 * max( \
                 (SELECT coalesce(max(to_s), 0) FROM arrival), (SELECT coalesce(max(arriving_from_s), 0) FROM run), \
                 (SELECT coalesce(max(arriving_from_s), 0) FROM link)))",
            )
            .await?;
            // These entries cover all rows, and their `from_s` is 0. A row that several entries cover belongs to the
            // entry with the largest `from_s`. Therefore the retention period of a row with a stored arrival time does
            // not restart.
            self.execute(
                "INSERT OR IGNORE INTO arrival (kind, owner, from_s, to_s, first, last) \
                 SELECT owner.kind, owner.id, 0, elapsed_ns / 1000000000, -9223372036854775808, 9223372036854775807 \
                 FROM storage_clock, (SELECT kind.column1 AS kind, run.number AS id \
                 FROM (VALUES (0), (1), (10), (60), (3600)) AS kind, run WHERE run.pinned = 0 \
                 UNION ALL SELECT -1, id FROM link) AS owner",
            )
            .await?;
        }
        Ok(())
    }

    /// Returns whether rows of one of these tables could not be read.
    fn has_unreadable(&self, tables: &[&str]) -> bool {
        tables.iter().any(|table| !self.unreadable_in(table).is_empty())
    }

    fn unreadable_in(&self, table: &str) -> &[UnreadableRange] {
        self.tables.get(table).map_or(&[], |table| &table.unreadable_ranges)
    }

    /// Executes a statement. Returns the number of changed rows.
    async fn execute(&mut self, sql: &str) -> Result<u64, sqlx::Error> {
        let result = sqlx::query(AssertSqlSafe(sql)).execute(&mut *self.connection).await?;
        Ok(result.rows_affected())
    }

    /// Inserts substitutes for lost rows to which measurements refer, and deletes other rows that refer to lost rows.
    ///
    /// A run of an unknown host gets another id, so events that the host's agent still sends begin another run.
    async fn restore_references(&mut self) -> Result<(), sqlx::Error> {
        let now = self.now_ns;
        let tables = self.tables;
        for (table, condition) in ORPHANS.into_iter().filter(|(table, _)| tables.contains_key(*table)) {
            self.execute(&format!("DELETE FROM {table} WHERE {condition}")).await?;
        }
        // SQLite assigns ids from 1 on, so the substitutes for an unknown pipeline and an unknown host can have the id 0.
        self.execute(&format!(
            "INSERT INTO run (number, uuid, pipeline, started_ns, ended_ns, end_reason, last_iteration_ns, placement, model, \
             facts, configuration, version) \
             SELECT run, {RANDOM_ID}, 0, min(started_ns), max(started_ns), 'unknown', max(started_ns), 'local', '{UNKNOWN}', \
             '[]', '', '' FROM iteration WHERE run NOT IN (SELECT number FROM run) GROUP BY run"
        ))
        .await?;
        self.execute(&format!(
            "INSERT INTO pipeline (id, host, name) SELECT DISTINCT pipeline, 0, '{UNKNOWN}-' || pipeline FROM run \
             WHERE pipeline NOT IN (SELECT id FROM pipeline)"
        ))
        .await?;
        self.execute(&format!(
            "UPDATE run SET uuid = {RANDOM_ID} WHERE pipeline IN \
             (SELECT id FROM pipeline WHERE host NOT IN (SELECT id FROM host))"
        ))
        .await?;
        // Incidents and gaps stay, because their texts are useful without the reference.
        self.execute("UPDATE incident SET run = NULL WHERE run NOT IN (SELECT number FROM run)").await?;
        self.execute("UPDATE incident SET peer = NULL WHERE peer NOT IN (SELECT id FROM host)").await?;
        self.execute("UPDATE gap SET run = NULL WHERE run NOT IN (SELECT number FROM run)").await?;
        self.execute(&format!(
            "INSERT INTO host (id, uuid, first_seen_ns, last_seen_ns) SELECT host, {RANDOM_ID}, {now}, {now} FROM \
             (SELECT host FROM pipeline UNION SELECT host FROM incident UNION SELECT host FROM gap) \
             WHERE host NOT IN (SELECT id FROM host)"
        ))
        .await?;
        Ok(())
    }

    /// Inserts substitutes for lost names. Otherwise a new name could get the id of a lost name, and old values would
    /// appear under the new name.
    async fn restore_names(&mut self) -> Result<(), sqlx::Error> {
        self.execute(
            "INSERT INTO name (id, text, kind, custom, unit) SELECT name, 'lost-name-' || name, 'value', 0, '' FROM \
             (SELECT DISTINCT name FROM node UNION SELECT DISTINCT name FROM rollup UNION SELECT DISTINCT name FROM verdict_count) \
             WHERE name NOT IN (SELECT id FROM name)",
        )
        .await?;
        Ok(())
    }

    /// Deletes the iterations whose nodes are not numbered from 0 without a gap. Returns their number.
    ///
    /// If the key of a row was overwritten, the row may look like a row of another tree. The row is then missing in its
    /// own tree, although no range of the file is unreadable.
    async fn delete_trees_with_missing_nodes(&mut self) -> Result<u64, sqlx::Error> {
        self.execute(
            "DELETE FROM iteration WHERE (run, number) IN (SELECT run, iteration FROM node GROUP BY run, iteration \
             HAVING count(*) <> max(node) + 1)",
        )
        .await
    }

    /// Deletes the iterations whose trees have unreadable rows, and the rows of trees whose iteration is lost.
    async fn delete_incomplete_trees(&mut self) -> Result<(), sqlx::Error> {
        for table in TREES {
            for UnreadableRange { before, after } in self.unreadable_in(table).to_vec() {
                let (from_run, from) = before.map_or((i64::MIN, 0), |[run, iteration, _]| (run, iteration));
                // If the first row after the range is a root, the tree of this root is complete.
                let (to_run, to) = match after {
                    Some([run, iteration, 0]) => (run, iteration - 1),
                    Some([run, iteration, _]) => (run, iteration),
                    None => (i64::MAX, i64::MAX),
                };
                sqlx::query("DELETE FROM iteration WHERE (run, number) BETWEEN (?1, ?2) AND (?3, ?4)")
                    .bind(from_run)
                    .bind(from)
                    .bind(to_run)
                    .bind(to)
                    .execute(&mut *self.connection)
                    .await?;
            }
        }
        for table in TREES {
            self.execute(&format!(
                "DELETE FROM {table} WHERE NOT EXISTS (SELECT 1 FROM iteration \
                 WHERE iteration.run = {table}.run AND iteration.number = {table}.iteration)"
            ))
            .await?;
        }
        Ok(())
    }

    /// Records the lost iterations of each run as a gap, so that they no longer count as stored. Returns the number of
    /// lost iterations.
    async fn record_gaps(&mut self) -> Result<i64, sqlx::Error> {
        let runs: Vec<i64> = sqlx::query_scalar("SELECT number FROM run ORDER BY number")
            .fetch_all(&mut *self.connection)
            .await?;
        let mut total_lost = 0;
        for run in runs {
            let run: IncompleteRun = sqlx::query_as(RUN).bind(run).fetch_one(&mut *self.connection).await?;
            let has_deleted_iterations = run.last_deleted_iteration != 0;
            // The counters of a run count all stored iterations. They cannot be used if retention has deleted iterations
            // of the run, or if the run is a substitute for a lost run. For these runs, only missing iteration numbers
            // show how many iterations are lost.
            let lost = if !has_deleted_iterations && run.counted > 0 {
                run.counted - run.stored
            } else {
                run.missing_numbers - run.in_gaps
            };
            // If retention has deleted iterations, missing numbers may not show all lost iterations. Therefore a gap is
            // recorded for an unreadable range even if no lost iteration is known.
            if lost > 0 || (has_deleted_iterations && self.has_unreadable_within(run.number)) {
                let lost = lost.max(0);
                total_lost += lost;
                self.insert_gap(&run, lost).await?;
            }
            if !has_deleted_iterations && run.counted != run.stored {
                self.recount_iterations(run.number).await?;
            }
        }
        Ok(total_lost)
    }

    /// Returns whether there is an unreadable range between two rows of the run.
    fn has_unreadable_within(&self, run: i64) -> bool {
        let is_within = |range: &UnreadableRange| {
            range.before.is_some_and(|[before, ..]| before == run)
                && range.after.is_some_and(|[after, ..]| after == run)
        };
        ["iteration", "node"].iter().any(|table| self.unreadable_in(table).iter().any(is_within))
    }

    /// Stores a gap of `lost` iterations of a run, and moves them from the host's stored events to its missing events.
    async fn insert_gap(&mut self, run: &IncompleteRun, lost: i64) -> Result<(), sqlx::Error> {
        sqlx::query(
            "INSERT INTO gap (host, pipeline, run, from_ns, to_ns, count, reason) VALUES (?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(run.host)
        .bind(&run.pipeline)
        .bind(run.number)
        .bind(run.gap_from_ns.min(run.gap_to_ns))
        .bind(run.gap_to_ns)
        .bind(lost)
        .bind(REASON)
        .execute(&mut *self.connection)
        .await?;
        sqlx::query(
            "UPDATE host SET gaps = gaps + 1, missing = missing + ?2, events = max(events - ?2, 0) WHERE id = ?1",
        )
        .bind(run.host)
        .bind(lost)
        .execute(&mut *self.connection)
        .await?;
        Ok(())
    }

    /// Counts the stored iterations of a run again and writes the counters of the run.
    async fn recount_iterations(&mut self, run: i64) -> Result<(), sqlx::Error> {
        sqlx::query(
            "UPDATE run SET (warm_up, ok, failed, lost, timeout) = (SELECT coalesce(sum(warm_up <> 0), 0), \
             coalesce(sum(warm_up = 0 AND outcome = 0), 0), coalesce(sum(warm_up = 0 AND outcome = 1), 0), \
             coalesce(sum(warm_up = 0 AND outcome = 2), 0), coalesce(sum(warm_up = 0 AND outcome = 3), 0) \
             FROM iteration WHERE run = ?1) WHERE number = ?1",
        )
        .bind(run)
        .execute(&mut *self.connection)
        .await?;
        Ok(())
    }

    /// Counts the nodes of each host again. If retention has deleted nodes of a host, the count of this host stays
    /// unchanged.
    async fn recount_nodes(&mut self) -> Result<(), sqlx::Error> {
        let runs: Vec<(i64, i64, i64)> = sqlx::query_as(
            "SELECT pipeline.host, run.number, run.nodes_from FROM run JOIN pipeline ON pipeline.id = run.pipeline",
        )
        .fetch_all(&mut *self.connection)
        .await?;
        let hosts: Vec<i64> =
            sqlx::query_scalar("SELECT id FROM host").fetch_all(&mut *self.connection).await?;
        let mut nodes: HashMap<i64, Option<i64>> = hosts.into_iter().map(|host| (host, Some(0))).collect();
        for (host, run, last_deleted_iteration) in runs {
            let sum = nodes.entry(host).or_insert(Some(0));
            // The deleted nodes are part of the host's count and cannot be counted any more.
            if last_deleted_iteration > 0 {
                *sum = None;
            }
            if let Some(sum) = sum {
                let nodes_of_run: i64 = sqlx::query_scalar("SELECT count(*) FROM node WHERE run = ?1")
                    .bind(run)
                    .fetch_one(&mut *self.connection)
                    .await?;
                *sum += nodes_of_run;
            }
        }
        for (host, nodes) in nodes {
            let Some(nodes) = nodes else { continue };
            sqlx::query("UPDATE host SET nodes = ?2 WHERE id = ?1")
                .bind(host)
                .bind(nodes)
                .execute(&mut *self.connection)
                .await?;
        }
        Ok(())
    }
}
