//! Iterations: lists, and single iterations with their tree, their rank and their neighbours.

use std::collections::HashMap;

use peernet_analysis::rows::Outcome;
use peernet_analysis::slowness::{self, IterationTimes, Medians};
use peernet_clock::{DelaySource, Span, Verdict};
use peernet_logger::{IterationValues, Name, NodeId, stage};
use sqlx::FromRow;

use super::clocks::PeriodAssumptions;
use super::{corrupt_data, count, sql, statistics, tree, value_of_number, wall};
use crate::column::column;
use crate::error::StoreError;
use crate::quantity_statistics::medians;
use crate::readers::Readers;
use crate::types::{DelayRow, IterationDetail, IterationFilter, IterationRow};

/// Name of the requested data in errors.
const WHAT: &str = "iterations";
/// Largest rank. Only this many of the slowest iterations have a rank.
const MAX_RANK: i64 = 1_000;

/// A row of the table `iteration`.
#[derive(FromRow)]
pub(super) struct Row {
    pub(super) number: i64,
    pub(super) episode: u32,
    pub(super) step: u32,
    pub(super) warm_up: bool,
    pub(super) outcome: u8,
    pub(super) reason: Option<String>,
    pub(super) started_ns: i64,
    total: Option<f64>,
}

/// Duration of one node.
#[derive(FromRow)]
struct NodeSeconds {
    iteration: i64,
    node: u32,
    parent: Option<u32>,
    /// Name of the node, such as a stage.
    #[sqlx(rename = "text")]
    name: String,
    #[sqlx(rename = "value")]
    seconds: f64,
}

/// A stored one-way delay.
#[derive(FromRow)]
struct Delay {
    iteration: i64,
    /// `upload` or `download`.
    #[sqlx(rename = "text")]
    stage: String,
    value: Option<f64>,
    lo: Option<f64>,
    hi: Option<f64>,
    /// The receiver's stamp minus the sender's stamp, each by the wall clock of its host.
    raw_ns: i64,
    source: u8,
    verdict: u8,
    sent_ns: i64,
    received_ns: Option<i64>,
    cloud: Option<i64>,
}

/// Rank of an iteration among the slowest iterations, and the numbers of the next slower and the next faster iteration.
#[derive(Default)]
struct Rank {
    rank: Option<u64>,
    slower: Option<u64>,
    faster: Option<u64>,
}

pub(crate) async fn slowest_iterations(
    readers: &Readers,
    run: i64,
    n: u32,
) -> Result<Vec<IterationRow>, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(sql::SLOWEST)
        .bind(run)
        .bind(n.min(1_000))
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    with_stages_and_causes(readers, run, rows).await
}

pub(crate) async fn iterations(
    readers: &Readers,
    run: i64,
    filter: &IterationFilter,
) -> Result<Vec<IterationRow>, StoreError> {
    let statement = if filter.failed_only { sql::FAILED_ITERATIONS } else { sql::ITERATIONS };
    let rows: Vec<Row> = sqlx::query_as(statement)
        .bind(run)
        .bind(column(filter.after))
        .bind(filter.limit.clamp(1, 1_000))
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    with_stages_and_causes(readers, run, rows).await
}

pub(crate) async fn iteration(
    readers: &Readers,
    run: i64,
    number: u64,
) -> Result<Option<IterationDetail>, StoreError> {
    let Ok(number) = i64::try_from(number) else { return Ok(None) };
    let row: Option<Row> = sqlx::query_as(sql::ITERATION)
        .bind(run)
        .bind(number)
        .fetch_optional(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let Some(row) = row else { return Ok(None) };
    let trees = tree::trees(readers, run, &[(number, wall(row.started_ns))]).await?;
    // Retention may have deleted the tree after the row was read.
    let Some((tree, hosts)) = trees.into_iter().flatten().next() else { return Ok(None) };
    let run_figures = statistics::statistics_by_name(readers, run).await?;
    let medians = medians(&run_figures);
    let neighbour = async |statement: &'static str| {
        let number: Option<i64> = sqlx::query_scalar(statement)
            .bind(run)
            .bind(number)
            .fetch_one(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        Ok(number.map(count))
    };
    let (previous, next) = (neighbour(sql::PREVIOUS).await?, neighbour(sql::NEXT).await?);
    let Some(row) = complete_rows(readers, run, vec![row], &medians).await?.pop() else { return Ok(None) };
    let Rank { rank, slower, faster } = match row.total {
        Some(total) if row.outcome == Outcome::Ok && !row.warm_up => {
            read_rank(readers, run, (total, number)).await?
        }
        _ => Rank::default(),
    };
    Ok(Some(IterationDetail { row, tree, hosts, rank, previous, next, slower, faster, run_figures }))
}

/// Returns the rank of a successful iteration. The result is empty if the iteration is not among the [`MAX_RANK`]
/// slowest iterations.
async fn read_rank(readers: &Readers, run: i64, (total, number): (f64, i64)) -> Result<Rank, StoreError> {
    let slower_count: i64 = sqlx::query_scalar(sql::SLOWER_COUNT)
        .bind(run)
        .bind(total)
        .fetch_one(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    if slower_count >= MAX_RANK {
        return Ok(Rank::default());
    }
    let neighbour = async |statement: &'static str| {
        let number: Option<i64> = sqlx::query_scalar(statement)
            .bind(run)
            .bind(total)
            .bind(number)
            .fetch_optional(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        Ok(number.map(count))
    };
    let rank = Some(count(slower_count) + 1);
    Ok(Rank { rank, slower: neighbour(sql::NEXT_SLOWER).await?, faster: neighbour(sql::NEXT_FASTER).await? })
}

/// Reads the run's medians, and completes the rows with them as [`complete_rows`] does.
async fn with_stages_and_causes(
    readers: &Readers,
    run: i64,
    rows: Vec<Row>,
) -> Result<Vec<IterationRow>, StoreError> {
    let medians = medians(&statistics::statistics_by_name(readers, run).await?);
    complete_rows(readers, run, rows, &medians).await
}

/// Adds the stages, the delays and the causes of slowness to rows of the table `iteration`. The number of queries does
/// not depend on the number of rows.
async fn complete_rows(
    readers: &Readers,
    run: i64,
    rows: Vec<Row>,
    medians: &Medians,
) -> Result<Vec<IterationRow>, StoreError> {
    let numbers: Vec<i64> = rows.iter().map(|row| row.number).collect();
    let numbers = serde_json::to_string(&numbers).map_err(|error| corrupt_data(WHAT, error))?;
    let durations: Vec<NodeSeconds> = sqlx::query_as(sql::DURATIONS)
        .bind(run)
        .bind(&numbers)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let delays: Vec<Delay> = sqlx::query_as(sql::DELAYS)
        .bind(run)
        .bind(&numbers)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let mut by_iteration: HashMap<i64, (IterationValues, Vec<DelayRow>)> = HashMap::with_capacity(rows.len());
    for NodeSeconds { iteration, node, parent, name, seconds } in durations {
        let (values, _) = by_iteration.entry(iteration).or_default();
        values.add(NodeId(node), parent.map(NodeId), &name, Some(seconds));
    }
    let times = || rows.iter().map(|row| row.started_ns);
    // Only delays need the assumptions of relation periods.
    let time_range = times().min().zip(times().max()).filter(|_| !delays.is_empty());
    let periods = match time_range {
        Some((from, to)) => Some(PeriodAssumptions::read(readers, run, (wall(from), wall(to))).await?),
        None => None,
    };
    for delay in delays {
        let iteration = delay.iteration;
        let row = delay.row(periods.as_ref())?;
        by_iteration.entry(iteration).or_default().1.push(row);
    }
    rows.into_iter()
        .map(|row| {
            let (values, delays) = by_iteration.remove(&row.number).unwrap_or_default();
            complete_row(row, &values, delays, medians)
        })
        .collect()
}

fn complete_row(
    row: Row,
    values: &IterationValues,
    delays: Vec<DelayRow>,
    medians: &Medians,
) -> Result<IterationRow, StoreError> {
    let stages: Vec<(Name, f64)> = stage::ORDER
        .into_iter()
        .filter_map(|stage| values.get(&stage).map(|seconds| (stage, seconds)))
        .collect();
    let unattributed = values.get(&stage::UNATTRIBUTED);
    let is_direction_unknown = delays.iter().any(|delay| delay.value.is_none());
    // If a one-way delay is unknown, only the sum of both directions is known.
    let both_ways = is_direction_unknown.then(|| {
        let other_stages = stages.iter().filter(|(name, _)| !stage::is_one_way(name));
        Some(slowness::both_ways(row.total?, other_stages.map(|(_, seconds)| *seconds), unattributed?))
    });
    let both_ways = both_ways.flatten();
    Ok(IterationRow {
        number: count(row.number),
        episode: row.episode,
        step: row.step,
        warm_up: row.warm_up,
        outcome: value_of_number(WHAT, &Outcome::ALL, row.outcome)?,
        reason: row.reason,
        started: wall(row.started_ns),
        total: row.total,
        factor: medians.ratio_to_median(row.total),
        causes: medians.causes(&IterationTimes {
            total: row.total,
            stages: &stages,
            lateness: values.get(&stage::LATENESS),
            unattributed,
            both_ways,
        }),
        stages,
        unattributed,
        both_ways,
        delays,
    })
}

impl Delay {
    fn row(self, periods: Option<&PeriodAssumptions>) -> Result<DelayRow, StoreError> {
        let source = value_of_number(WHAT, DelaySource::ALL, self.source)?;
        let is_upload = stage::UPLOAD == self.stage.as_str();
        // The times of relation periods are readings of the edge's clock. The edge stamps the departure of an upload
        // and the arrival of a download.
        let edge_ns = if is_upload { Some(self.sent_ns) } else { self.received_ns };
        let assumptions = match (periods, self.cloud, edge_ns) {
            (Some(periods), Some(cloud), Some(at)) if source != DelaySource::SameClock => {
                periods.at(cloud, wall(at))?
            }
            _ => None,
        };
        Ok(DelayRow {
            stage: Name::from(self.stage.as_str()),
            value: self.value,
            bounds: self.lo.zip(self.hi),
            raw: Span::from_nanos(self.raw_ns).seconds(),
            source,
            verdict: value_of_number(WHAT, Verdict::ALL, self.verdict)?,
            assumptions,
        })
    }
}
