//! Deletion of a run's iterations with their nodes, transits and anchors.

use sqlx::SqliteConnection;

use super::trimmed::record_trimmed;
use super::{DeletedRows, Kind};
use crate::extent::Extent;

/// Maximum number of iterations whose numbers are read at a time.
const PAGE: i64 = 500;
/// Estimated cost of the first iteration, in rows of `node`. For later iterations, the estimate is the cost of the
/// iterations that were deleted last.
const FIRST_COST_ESTIMATE: u64 = 32;
/// Cost of deleting the row of an iteration, in rows of `node`. The row is also in two indexes.
const ITERATION_COST: u64 = 4;

/// The iterations with the lowest numbers of a range: ?1 run, ?2 and ?3 first and last number, ?4
/// limit.
const LOWEST: &str = "SELECT number, started_ns FROM iteration WHERE run = ?1 AND number BETWEEN ?2 AND ?3 \
     ORDER BY number LIMIT ?4";
/// Deletes the nodes of a range of iterations: ?1 run, ?2 and ?3 number of the first and of the last iteration. The
/// next three statements have the same parameters.
const NODE: &str = "DELETE FROM node WHERE run = ?1 AND iteration BETWEEN ?2 AND ?3";
const TRANSIT: &str = "DELETE FROM transit WHERE run = ?1 AND iteration BETWEEN ?2 AND ?3";
const ANCHOR: &str = "DELETE FROM anchor WHERE run = ?1 AND iteration BETWEEN ?2 AND ?3";
const ITERATIONS: &str = "DELETE FROM iteration WHERE run = ?1 AND number BETWEEN ?2 AND ?3";
/// Records the last deleted iteration of a run: ?1 run, ?2 number of this iteration.
const NODES_FROM: &str = "UPDATE run SET nodes_from = max(nodes_from, ?2) WHERE number = ?1";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 6] = [
    ("LOWEST", LOWEST),
    ("NODE", NODE),
    ("TRANSIT", TRANSIT),
    ("ANCHOR", ANCHOR),
    ("ITERATIONS", ITERATIONS),
    ("NODES_FROM", NODES_FROM),
];

/// Deletes a range of iterations, the lowest number first, at a cost of about `max_cost` rows of the table `node`.
pub(super) async fn delete(
    connection: &mut SqliteConnection,
    run: i64,
    numbers: Extent,
    max_cost: u64,
) -> Result<DeletedRows, sqlx::Error> {
    let mut deleted = DeletedRows::default();
    let mut cost_per_iteration = FIRST_COST_ESTIMATE;
    loop {
        let page: Vec<(i64, i64)> = sqlx::query_as(LOWEST)
            .bind(run)
            .bind(numbers.first)
            .bind(numbers.last)
            .bind(PAGE)
            .fetch_all(&mut *connection)
            .await?;
        if page.is_empty() {
            return Ok(DeletedRows { is_complete: true, ..deleted });
        }
        let mut remaining = &page[..];
        while let Some((from, _)) = remaining.first() {
            if deleted.cost >= max_cost {
                return Ok(deleted);
            }
            // At least one iteration is deleted, so that every step makes progress.
            let affordable = usize::try_from((max_cost - deleted.cost) / cost_per_iteration)
                .unwrap_or(usize::MAX)
                .clamp(1, remaining.len());
            let (iterations, later) = remaining.split_at(affordable);
            let through = iterations.last().map_or(*from, |(number, _)| *number);
            let mut cost = iterations.len() as u64 * ITERATION_COST;
            for statement in [NODE, TRANSIT, ANCHOR, ITERATIONS] {
                let deletion = sqlx::query(statement).bind(run).bind(from).bind(through);
                cost += deletion.execute(&mut *connection).await?.rows_affected();
            }
            // The newest start is not always that of the last number: a host's clock may have been
            // set back.
            let seconds = iterations.iter().map(|(_, started_ns)| started_ns.div_euclid(1_000_000_000));
            let newest_s = seconds.max().unwrap_or(i64::MIN);
            record_trimmed(connection, Kind::Nodes, run, newest_s.saturating_add(1)).await?;
            sqlx::query(NODES_FROM).bind(run).bind(through).execute(&mut *connection).await?;
            cost_per_iteration = (cost / iterations.len() as u64).max(1);
            deleted.cost += cost;
            deleted.items += iterations.len() as u64;
            remaining = later;
        }
    }
}
