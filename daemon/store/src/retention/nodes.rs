//! Deletion of iterations of a run, with everything that belongs to them.

use sqlx::SqliteConnection;

use super::trimmed::record_trimmed;
use super::{DeletedRows, Kind};
use crate::extent::Extent;

/// Number of iterations read together.
const PAGE: i64 = 500;
/// First guess of the nodes per iteration.
const NODES_PER_ITERATION: u64 = 32;
/// Cost of an iteration without its nodes, in rows of `node`: two indexes and two more tables.
const ITERATION_COST: u64 = 4;

/// ?1 run, ?2 and ?3 first and last number, ?4 limit.
const OLDEST: &str = "SELECT number, started_ns FROM iteration WHERE run = ?1 AND number BETWEEN ?2 AND ?3 \
     ORDER BY number LIMIT ?4";
/// ?1 run, ?2 and ?3 first and last iteration; the same for the others.
const NODE: &str = "DELETE FROM node WHERE run = ?1 AND iteration BETWEEN ?2 AND ?3";
const TRANSIT: &str = "DELETE FROM transit WHERE run = ?1 AND iteration BETWEEN ?2 AND ?3";
const ANCHOR: &str = "DELETE FROM anchor WHERE run = ?1 AND iteration BETWEEN ?2 AND ?3";
const ITERATIONS: &str = "DELETE FROM iteration WHERE run = ?1 AND number BETWEEN ?2 AND ?3";
/// ?1 run, ?2 the last deleted iteration.
const NODES_FROM: &str = "UPDATE run SET nodes_from = max(nodes_from, ?2) WHERE number = ?1";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 6] = [
    ("OLDEST", OLDEST),
    ("NODE", NODE),
    ("TRANSIT", TRANSIT),
    ("ANCHOR", ANCHOR),
    ("ITERATIONS", ITERATIONS),
    ("NODES_FROM", NODES_FROM),
];

/// Deletes iterations by ascending number, at a cost of about `max_cost` rows of the table `node`.
pub(super) async fn delete(
    connection: &mut SqliteConnection,
    run: i64,
    numbers: Extent,
    max_cost: u64,
) -> Result<DeletedRows, sqlx::Error> {
    let mut deleted = DeletedRows::default();
    let mut per_iteration = NODES_PER_ITERATION;
    loop {
        let page: Vec<(i64, i64)> = sqlx::query_as(OLDEST)
            .bind(run)
            .bind(numbers.first)
            .bind(numbers.last)
            .bind(PAGE)
            .fetch_all(&mut *connection)
            .await?;
        if page.is_empty() {
            return Ok(DeletedRows { complete: true, ..deleted });
        }
        let mut old = &page[..];
        while let Some((from, _)) = old.first() {
            if deleted.cost >= max_cost {
                return Ok(deleted);
            }
            let together = usize::try_from((max_cost - deleted.cost) / per_iteration)
                .unwrap_or(usize::MAX)
                .clamp(1, old.len());
            let (now, later) = old.split_at(together);
            let through = now.last().map_or(*from, |(number, _)| *number);
            let mut cost = now.len() as u64 * ITERATION_COST;
            for table in [NODE, TRANSIT, ANCHOR, ITERATIONS] {
                let done = sqlx::query(table).bind(run).bind(from).bind(through);
                cost += done.execute(&mut *connection).await?.rows_affected();
            }
            let seconds = now.iter().map(|(_, started_ns)| started_ns.div_euclid(1_000_000_000));
            let newest_s = seconds.max().unwrap_or(i64::MIN);
            record_trimmed(connection, Kind::Nodes, run, newest_s.saturating_add(1)).await?;
            sqlx::query(NODES_FROM).bind(run).bind(through).execute(&mut *connection).await?;
            per_iteration = (cost / now.len() as u64).max(1);
            deleted.cost += cost;
            deleted.items += now.len() as u64;
            old = later;
        }
    }
}
