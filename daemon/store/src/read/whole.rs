//! Whole iterations with their trees, as the agent sent them, many at a time.

use peernet_analysis::rows;
use peernet_stream::{Iteration, Outcome};

use super::iterations::Row;
use super::{corrupt_data, count, sql, tree, value_of_number, wall};
use crate::column::column;
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::RunSummary;

/// Name of the requested data in errors.
const WHAT: &str = "whole iterations";
/// Maximum number of iterations in a result. A tree may be large.
const MAX_ITERATIONS: u32 = 200;
/// Number of iterations of which one statement compares the shapes of the trees: the names, the parents and the missing
/// values of the nodes. The statement reads all nodes of these iterations and must not exceed the time limit of a
/// statement.
const ITERATIONS_PER_COMPARISON: u32 = 5_000;

pub(crate) async fn full_iterations(
    readers: &Readers,
    run: &RunSummary,
    after: u64,
) -> Result<Option<(u64, Vec<Iteration>)>, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(sql::ITERATIONS)
        .bind(run.number)
        .bind(column(after))
        .bind(MAX_ITERATIONS)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let Some(last) = rows.last().map(|row| count(row.number)) else { return Ok(None) };
    Ok(Some((last, with_trees(readers, run, rows).await?)))
}

pub(crate) async fn iterations_by_shape(
    readers: &Readers,
    run: &RunSummary,
    after: u64,
) -> Result<Option<(u64, Vec<Iteration>)>, StoreError> {
    let last: Option<i64> = sqlx::query_scalar(sql::LAST_OF_PAGE)
        .bind(run.number)
        .bind(column(after))
        .bind(ITERATIONS_PER_COMPARISON)
        .fetch_one(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let Some(mut last) = last else { return Ok(None) };
    let numbers: Vec<i64> = sqlx::query_scalar(sql::SHAPES)
        .bind(run.number)
        .bind(column(after))
        .bind(last)
        .bind(MAX_ITERATIONS)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    // There may be more shapes than one result can have. Up to its last iteration, the result has all shapes, so the
    // next call continues there.
    if numbers.len() == MAX_ITERATIONS as usize
        && let Some(last_number) = numbers.last()
    {
        last = *last_number;
    }
    let numbers = serde_json::to_string(&numbers).map_err(|error| corrupt_data(WHAT, error))?;
    let rows: Vec<Row> = sqlx::query_as(sql::ITERATIONS_BY_NUMBER)
        .bind(run.number)
        .bind(numbers)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    Ok(Some((count(last), with_trees(readers, run, rows).await?)))
}

/// Adds the trees to rows of the table `iteration`. Iterations that retention has deleted meanwhile are left out.
async fn with_trees(
    readers: &Readers,
    run: &RunSummary,
    rows: Vec<Row>,
) -> Result<Vec<Iteration>, StoreError> {
    let numbers_and_starts: Vec<_> = rows.iter().map(|row| (row.number, wall(row.started_ns))).collect();
    let trees = tree::trees(readers, run.number, &numbers_and_starts).await?;
    rows.into_iter()
        .zip(trees)
        .filter_map(|(row, stored)| Some((row, stored?.0)))
        .map(|(row, tree)| {
            Ok(Iteration {
                run: run.id,
                number: count(row.number),
                episode: row.episode,
                step: row.step,
                warm_up: row.warm_up,
                outcome: outcome(row.outcome, row.reason)?,
                tree,
            })
        })
        .collect()
}

/// Returns the outcome for a number of the table `outcome`.
fn outcome(number: u8, reason: Option<String>) -> Result<Outcome, StoreError> {
    let reason = reason.unwrap_or_default();
    Ok(match value_of_number(WHAT, &rows::Outcome::ALL, number)? {
        rows::Outcome::Ok => Outcome::Ok,
        rows::Outcome::Failed => Outcome::Failed(reason),
        rows::Outcome::Lost => Outcome::Lost(reason),
        rows::Outcome::Timeout => Outcome::Timeout(reason),
    })
}
