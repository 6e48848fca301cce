//! Iterations.

use peernet_logger::{Name, stage};
use sqlx::{FromRow, SqlitePool};

use super::{corrupt, count, failed, sql, statistics, tree, wall};
use crate::error::StoreError;
use crate::figures::Figures;
use crate::store::types::{Blame, IterationDetail, IterationFilter, IterationRow};

const WHAT: &str = "iterations";
/// Names of the rows of the table `outcome`.
const OUTCOMES: [&str; 4] = ["ok", "failed", "lost", "timeout"];
/// How far down an iteration's place among the slowest is counted.
const RANKED: i64 = 1_000;

#[derive(FromRow)]
pub(super) struct Row {
    number: i64,
    episode: u32,
    step: u32,
    warm_up: bool,
    outcome: u8,
    reason: Option<String>,
    pub(super) started_ns: i64,
    total: Option<f64>,
}

/// The run's figures, with which its iterations are compared.
struct Comparison(Vec<(Name, Figures)>);

impl Comparison {
    fn median(&self, name: &str) -> Option<f64> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, figures)| figures.p50)
    }

    fn factor(&self, total: Option<f64>) -> Option<f64> {
        let median = self.median(&stage::TOTAL).filter(|median| *median > 0.0)?;
        Some(total? / median)
    }

    /// What exceeds its own median most. What no stage accounts for is a candidate like any stage: blaming the
    /// second largest excess would send the reader to the wrong place.
    fn blame(&self, stages: &[(Name, f64)], unattributed: Option<f64>) -> Option<Blame> {
        let rest = unattributed.map(|value| (stage::UNATTRIBUTED, value));
        let compared = stages.iter().chain(&rest).filter_map(|(stage, value)| {
            Some(Blame { stage: stage.clone(), value: *value, median: self.median(stage)? })
        });
        let over = |blame: &Blame| blame.value - blame.median;
        compared.filter(|blame| over(blame) > 0.0).max_by(|a, b| over(a).total_cmp(&over(b)))
    }
}

pub(in crate::store) async fn slowest(
    pool: &SqlitePool,
    run: i64,
    n: u32,
) -> Result<Vec<IterationRow>, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(sql::SLOWEST)
        .bind(run)
        .bind(n.min(1_000))
        .fetch_all(pool)
        .await
        .map_err(failed(WHAT))?;
    complete(pool, run, rows).await
}

pub(in crate::store) async fn iterations(
    pool: &SqlitePool,
    run: i64,
    filter: &IterationFilter,
) -> Result<Vec<IterationRow>, StoreError> {
    let statement = if filter.unsuccessful { sql::ITERATIONS_WITHOUT_ANSWER } else { sql::ITERATIONS };
    let rows: Vec<Row> = sqlx::query_as(statement)
        .bind(run)
        .bind(i64::try_from(filter.after).unwrap_or(i64::MAX))
        .bind(filter.limit.clamp(1, 1_000))
        .fetch_all(pool)
        .await
        .map_err(failed(WHAT))?;
    complete(pool, run, rows).await
}

pub(in crate::store) async fn iteration(
    pool: &SqlitePool,
    run: i64,
    number: u64,
) -> Result<Option<IterationDetail>, StoreError> {
    let Ok(number) = i64::try_from(number) else { return Ok(None) };
    let row: Option<Row> = sqlx::query_as(sql::ITERATION)
        .bind(run)
        .bind(number)
        .fetch_optional(pool)
        .await
        .map_err(failed(WHAT))?;
    let Some(row) = row else { return Ok(None) };
    let (tree, hosts) = tree::tree(pool, run, number, wall(row.started_ns)).await?;
    let comparison = Comparison(statistics::figures(pool, run).await?);
    let rank = match row.total {
        Some(total) if row.outcome == 0 && !row.warm_up => {
            let slower: i64 = sqlx::query_scalar(sql::SLOWER)
                .bind(run)
                .bind(total)
                .fetch_one(pool)
                .await
                .map_err(failed(WHAT))?;
            (slower < RANKED).then(|| count(slower) + 1)
        }
        _ => None,
    };
    let neighbour = async |statement: &'static str| {
        let number: Option<i64> = sqlx::query_scalar(statement)
            .bind(run)
            .bind(number)
            .fetch_one(pool)
            .await
            .map_err(failed(WHAT))?;
        Ok(number.map(count))
    };
    let (previous, next) = (neighbour(sql::PREVIOUS).await?, neighbour(sql::NEXT).await?);
    let row = complete_row(pool, run, row, &comparison).await?;
    Ok(Some(IterationDetail { row, tree, hosts, rank, previous, next, run_figures: comparison.0 }))
}

async fn complete(pool: &SqlitePool, run: i64, rows: Vec<Row>) -> Result<Vec<IterationRow>, StoreError> {
    let comparison = Comparison(statistics::figures(pool, run).await?);
    let mut complete = Vec::with_capacity(rows.len());
    for row in rows {
        complete.push(complete_row(pool, run, row, &comparison).await?);
    }
    Ok(complete)
}

async fn complete_row(
    pool: &SqlitePool,
    run: i64,
    row: Row,
    comparison: &Comparison,
) -> Result<IterationRow, StoreError> {
    let durations: Vec<(String, f64)> = sqlx::query_as(sql::DURATIONS)
        .bind(run)
        .bind(row.number)
        .fetch_all(pool)
        .await
        .map_err(failed(WHAT))?;
    let seconds_of = |stage: &Name| {
        let of_stage = durations.iter().filter(|(name, _)| stage == name.as_str());
        let values: Vec<f64> = of_stage.map(|(_, value)| *value).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>())
    };
    let stages: Vec<(Name, f64)> =
        stage::ORDER.into_iter().filter_map(|stage| Some((stage.clone(), seconds_of(&stage)?))).collect();
    let unattributed = seconds_of(&stage::UNATTRIBUTED);
    let outcome = OUTCOMES
        .get(usize::from(row.outcome))
        .ok_or_else(|| corrupt(WHAT, format_args!("outcome {}", row.outcome)))?;
    Ok(IterationRow {
        number: count(row.number),
        episode: row.episode,
        step: row.step,
        warm_up: row.warm_up,
        outcome: (*outcome).to_owned(),
        reason: row.reason,
        started: wall(row.started_ns),
        total: row.total,
        factor: comparison.factor(row.total),
        blame: comparison.blame(&stages, unattributed),
        stages,
        unattributed,
    })
}
