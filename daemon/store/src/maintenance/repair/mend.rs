//! Makes the salvaged rows agree with each other, and records what is lost.

use std::collections::{BTreeMap, HashMap};

use sqlx::{AssertSqlSafe, FromRow, SqliteConnection};

use super::rows::{CopiedTable, Hole};
use crate::write::UNKNOWN;

/// Reason of the gaps.
const REASON: &str = "the database was damaged, and its repair could not read these rows";

/// A random id in SQL.
const RANDOM_ID: &str = "lower(hex(randomblob(4)) || '-' || hex(randomblob(2)) || '-4' || substr(hex(randomblob(2)), 2) \
     || '-a' || substr(hex(randomblob(2)), 2) || '-' || hex(randomblob(6)))";

/// Tables in which an iteration has rows of its tree.
const TREES: [&str; 3] = ["node", "transit", "anchor"];

/// Rows that refer to rows that are lost: they are deleted. A host whose stream is lost is asked what it still has, as
/// after a restored backup.
const ORPHANS: [(&str, &str); 7] = [
    ("stream", "host NOT IN (SELECT id FROM host)"),
    ("quarantine", "host NOT IN (SELECT id FROM host)"),
    ("link", "edge NOT IN (SELECT id FROM host) OR cloud NOT IN (SELECT id FROM host)"),
    ("host_secret", "host NOT IN (SELECT id FROM host)"),
    ("clock_sample", "link NOT IN (SELECT id FROM link)"),
    ("clock_window", "link NOT IN (SELECT id FROM link)"),
    ("connection_sample", "link NOT IN (SELECT id FROM link)"),
];

/// What the salvaged tables lack.
pub(super) struct Mending<'a> {
    pub(super) connection: &'a mut SqliteConnection,
    pub(super) tables: &'a BTreeMap<String, CopiedTable>,
    pub(super) now_ns: i64,
}

/// A run with iterations that are lost.
#[derive(Debug, FromRow)]
struct Lacking {
    number: i64,
    host: i64,
    pipeline: String,
    from_ns: i64,
    to_ns: i64,
    /// Iterations that retention has deleted are below.
    nodes_from: i64,
    counted: i64,
    stored: i64,
    /// Numbers between the first stored iteration that retention left and the last that are not stored.
    holes: i64,
    /// Events in the gaps that the run has already.
    known: i64,
}

/// ?1 run. Stored numbers rise from 1, or from what retention has left.
const RUN: &str = "SELECT run.number, pipeline.host, pipeline.name AS pipeline, run.nodes_from, \
     run.warm_up + run.ok + run.failed + run.lost + run.timeout AS counted, \
     (SELECT count(*) FROM iteration WHERE run = ?1) AS stored, \
     (SELECT coalesce(max(number) - min(number) + 1 - count(*), 0) FROM iteration \
         WHERE run = ?1 AND number > run.nodes_from) AS holes, \
     (SELECT coalesce(sum(count), 0) FROM gap WHERE run = ?1) AS known, \
     coalesce((SELECT started_ns FROM iteration AS it WHERE run = ?1 AND NOT EXISTS \
         (SELECT 1 FROM iteration WHERE run = ?1 AND number = it.number + 1) \
         AND (SELECT min(number) FROM iteration WHERE run = ?1) <= run.nodes_from + 1 \
         ORDER BY number LIMIT 1), run.started_ns) AS from_ns, \
     max(coalesce((SELECT started_ns FROM iteration AS it WHERE run = ?1 AND NOT EXISTS \
         (SELECT 1 FROM iteration WHERE run = ?1 AND number = it.number - 1) \
         AND (SELECT max(started_ns) FROM iteration WHERE run = ?1) >= run.last_iteration_ns \
         ORDER BY number DESC LIMIT 1), run.last_iteration_ns, run.started_ns), run.started_ns) AS to_ns \
     FROM run JOIN pipeline ON pipeline.id = run.pipeline WHERE run.number = ?1";

impl Mending<'_> {
    /// Does all of it, and returns how many iterations are lost, as far as that can be known.
    pub(super) async fn run(mut self) -> Result<i64, sqlx::Error> {
        if self.lacks(&["host", "pipeline", "run", "link"]) {
            self.references().await?;
            self.execute(
                "UPDATE host SET (gaps, missing) = (SELECT count(*), coalesce(sum(count), 0) FROM gap WHERE gap.host = host.id)",
            )
            .await?;
        }
        if self.lacks(&["name"]) {
            self.names().await?;
        }
        let mut lost = 0;
        let torn = self.torn_trees().await?;
        if torn > 0 || self.lacks(&["iteration", "node", "transit", "anchor", "run"]) {
            self.trees().await?;
            lost = self.gaps().await?;
        }
        if torn > 0 || self.lacks(&["host", "pipeline", "run", "iteration", "node", "transit", "anchor"]) {
            self.count_nodes().await?;
        }
        if self.lacks(&["arrival", "storage_clock", "retained", "run", "link"]) {
            self.retention().await?;
        }
        Ok(lost)
    }

    /// What is not known to have an end to its keeping has it as if it had just arrived.
    async fn retention(&mut self) -> Result<(), sqlx::Error> {
        if self.tables.contains_key("retained") {
            self.execute(
                "INSERT OR IGNORE INTO retained (kind, run) \
                 SELECT kind.column1, run.number FROM (VALUES (0), (1), (10), (60), (3600)) AS kind, run WHERE run.pinned = 0",
            )
            .await?;
        }
        if self.tables.contains_key("arrival") {
            // The storage clock does not go back behind what it has shown.
            self.execute(
                "UPDATE storage_clock SET elapsed_ns = max(elapsed_ns, 1000000000 * max( \
                 (SELECT coalesce(max(to_s), 0) FROM arrival), (SELECT coalesce(max(arriving_from_s), 0) FROM run), \
                 (SELECT coalesce(max(arriving_from_s), 0) FROM link)))",
            )
            .await?;
            // Rows from then on go before this one.
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

    fn lacks(&self, tables: &[&str]) -> bool {
        tables.iter().any(|table| !self.holes(table).is_empty())
    }

    fn holes(&self, table: &str) -> &[Hole] {
        self.tables.get(table).map_or(&[], |table| &table.holes)
    }

    async fn execute(&mut self, sql: &str) -> Result<u64, sqlx::Error> {
        let done = sqlx::query(AssertSqlSafe(sql)).execute(&mut *self.connection).await?;
        Ok(done.rows_affected())
    }

    /// Stands in for lost rows that measurements refer to; other rows that refer to lost ones are deleted. A run of a host
    /// that is not known gets another id: what its agent still sends of it begins a run of its own.
    async fn references(&mut self) -> Result<(), sqlx::Error> {
        let now = self.now_ns;
        let tables = self.tables;
        for (table, orphaned) in ORPHANS.into_iter().filter(|(table, _)| tables.contains_key(*table)) {
            self.execute(&format!("DELETE FROM {table} WHERE {orphaned}")).await?;
        }
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

    /// A number that comes to mean another name would make old values look like what they are not.
    async fn names(&mut self) -> Result<(), sqlx::Error> {
        self.execute(
            "INSERT INTO name (id, text, kind, custom, unit) SELECT name, 'lost-name-' || name, 'value', 0, '' FROM \
             (SELECT DISTINCT name FROM node UNION SELECT DISTINCT name FROM rollup UNION SELECT DISTINCT name FROM verdict_count) \
             WHERE name NOT IN (SELECT id FROM name)",
        )
        .await?;
        Ok(())
    }

    /// Deletes the iterations whose nodes are not numbered from 0 without a gap, and returns how many.
    ///
    /// A row whose key was overwritten may still look like a row, of another tree: no hole shows that it is missing.
    async fn torn_trees(&mut self) -> Result<u64, sqlx::Error> {
        self.execute(
            "DELETE FROM iteration WHERE (run, number) IN (SELECT run, iteration FROM node GROUP BY run, iteration \
             HAVING count(*) <> max(node) + 1)",
        )
        .await
    }

    /// An iteration is there with all of its tree or not at all.
    async fn trees(&mut self) -> Result<(), sqlx::Error> {
        for table in TREES {
            for Hole { before, after } in self.holes(table).to_vec() {
                let (from_run, from) = before.map_or((i64::MIN, 0), |[run, iteration, _]| (run, iteration));
                // A tree of which the root was read after the hole is whole.
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
        if self.lacks(&["run"]) {
            self.execute("DELETE FROM iteration WHERE run NOT IN (SELECT number FROM run)").await?;
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

    /// What is lost of each run becomes a gap, and no longer counts as stored.
    async fn gaps(&mut self) -> Result<i64, sqlx::Error> {
        let runs: Vec<i64> = sqlx::query_scalar("SELECT number FROM run ORDER BY number")
            .fetch_all(&mut *self.connection)
            .await?;
        let mut all = 0;
        for run in runs {
            let run: Lacking = sqlx::query_as(RUN).bind(run).fetch_one(&mut *self.connection).await?;
            let whole = run.nodes_from == 0;
            // The run's own counters were stored with its iterations. Of one that retention has begun to delete, and of one
            // that was made anew, only holes between the numbers tell.
            let lost =
                if whole && run.counted > 0 { run.counted - run.stored } else { run.holes - run.known };
            if lost > 0 || (!whole && self.has_hole_within(run.number)) {
                let lost = lost.max(0);
                all += lost;
                self.gap(&run, lost).await?;
            }
            if whole && run.counted != run.stored {
                self.count_again(run.number).await?;
            }
        }
        Ok(all)
    }

    /// Whether something of that run, and of no other, could not be read.
    fn has_hole_within(&self, run: i64) -> bool {
        let within = |hole: &Hole| {
            hole.before.is_some_and(|[before, ..]| before == run)
                && hole.after.is_some_and(|[after, ..]| after == run)
        };
        ["iteration", "node"].iter().any(|table| self.holes(table).iter().any(within))
    }

    async fn gap(&mut self, run: &Lacking, lost: i64) -> Result<(), sqlx::Error> {
        sqlx::query(
            "INSERT INTO gap (host, pipeline, run, from_ns, to_ns, count, reason) VALUES (?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(run.host)
        .bind(&run.pipeline)
        .bind(run.number)
        .bind(run.from_ns.min(run.to_ns))
        .bind(run.to_ns)
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

    async fn count_again(&mut self, run: i64) -> Result<(), sqlx::Error> {
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

    /// Nodes of hosts of which retention has deleted nothing.
    async fn count_nodes(&mut self) -> Result<(), sqlx::Error> {
        let runs: Vec<(i64, i64, i64)> = sqlx::query_as(
            "SELECT pipeline.host, run.number, run.nodes_from FROM run JOIN pipeline ON pipeline.id = run.pipeline",
        )
        .fetch_all(&mut *self.connection)
        .await?;
        let hosts: Vec<i64> =
            sqlx::query_scalar("SELECT id FROM host").fetch_all(&mut *self.connection).await?;
        let mut nodes: HashMap<i64, Option<i64>> = hosts.into_iter().map(|host| (host, Some(0))).collect();
        for (host, run, nodes_from) in runs {
            let sum = nodes.entry(host).or_insert(Some(0));
            if nodes_from > 0 {
                *sum = None;
            }
            if let Some(sum) = sum {
                let more: i64 = sqlx::query_scalar("SELECT count(*) FROM node WHERE run = ?1")
                    .bind(run)
                    .fetch_one(&mut *self.connection)
                    .await?;
                *sum += more;
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
