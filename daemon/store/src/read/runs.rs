//! Runs and experiments.

use std::collections::HashMap;

use peernet_analysis::actuator_results::{ActuatorResults, EPISODE_VALUES, SUPERSEDED};
use peernet_analysis::deadline::{DEADLINE_MISSED, Misses};
use peernet_clock::WallTime;
use peernet_external::exec::{hide_arguments, hide_arguments_in_facts};
use peernet_logger::stage;
use peernet_stream::{EndReason, FaultyHost, OutcomeCounts, Placement, PlacementKind};
use serde::de::DeserializeOwned;
use sqlx::FromRow;

use super::{corrupt_data, count, parse, parse_name, sql, statistics, wall};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::{ExperimentSummary, GapRow, NameSummary, RunDetail, RunFilter, RunSummary};
use crate::write::UNKNOWN;

/// Name of the requested data in errors.
const WHAT: &str = "runs";

#[derive(FromRow)]
struct RunRow {
    number: i64,
    uuid: String,
    host_uuid: String,
    host_name: Option<String>,
    pipeline: String,
    placement: String,
    peer: Option<String>,
    network: Option<String>,
    address: Option<String>,
    model: String,
    device: Option<String>,
    started_ns: i64,
    ended_ns: Option<i64>,
    end_reason: Option<String>,
    last_iteration_ns: Option<i64>,
    warm_up: i64,
    ok: i64,
    failed: i64,
    lost: i64,
    timeout: i64,
    skipped_starts: i64,
    facts: String,
    configuration: String,
    version: String,
    pinned: bool,
    nodes_from: i64,
    experiment: Option<String>,
    conditions: Option<String>,
}

#[derive(FromRow)]
struct ExperimentRow {
    newest: i64,
    oldest: i64,
    name: Option<String>,
    id: String,
    runs: i64,
    open: i64,
    started_ns: i64,
}

pub(crate) async fn runs(readers: &Readers, filter: &RunFilter) -> Result<Vec<RunSummary>, StoreError> {
    let before = filter.before.unwrap_or(i64::MAX);
    let limit = filter.limit.clamp(1, 1_000);
    // There are two statements, so that SQLite uses the suitable index for each.
    let rows: Vec<RunRow> = if filter.pipeline.is_none() && filter.host.is_none() {
        sqlx::query_as(sql::RUNS).bind(before).bind(limit).fetch_all(&readers.pool()).await
    } else {
        sqlx::query_as(sql::RUNS_FILTERED)
            .bind(before)
            .bind(limit)
            .bind(filter.pipeline.as_ref().map(ToString::to_string))
            .bind(filter.host.map(|host| host.to_string()))
            .fetch_all(&readers.pool())
            .await
    }
    .map_err(readers.error_for(WHAT))?;
    summaries(readers, &rows).await
}

/// Returns at most `limit` runs of an experiment, oldest first.
pub(crate) async fn runs_of_experiment(
    readers: &Readers,
    id: &str,
    limit: u32,
) -> Result<Vec<RunSummary>, StoreError> {
    let rows: Vec<RunRow> = sqlx::query_as(sql::RUNS_OF_EXPERIMENT)
        .bind(id)
        .bind(limit.clamp(1, 1_000))
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    summaries(readers, &rows).await
}

/// Returns experiments, the one with the newest run first.
pub(crate) async fn experiments(readers: &Readers, limit: u32) -> Result<Vec<ExperimentSummary>, StoreError> {
    let rows: Vec<ExperimentRow> = sqlx::query_as(sql::EXPERIMENTS)
        .bind(limit.clamp(1, 1_000))
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for("experiments"))?;
    let summary = |row: ExperimentRow| ExperimentSummary {
        id: row.id,
        name: row.name.unwrap_or_default(),
        runs: count(row.runs),
        open: count(row.open),
        first_run: row.oldest,
        last_run: row.newest,
        started: wall(row.started_ns),
    };
    Ok(rows.into_iter().map(summary).collect())
}

async fn summaries(readers: &Readers, rows: &[RunRow]) -> Result<Vec<RunSummary>, StoreError> {
    let numbers: Vec<i64> = rows.iter().map(|row| row.number).collect();
    let totals = statistics::whole_runs(readers, &numbers, &stage::TOTAL).await?;
    // Each query reads all runs of the list, so a longer list needs no more queries.
    let deadline_missed = deadline_missed_summaries(readers, rows).await?;
    let actuators = actuator_results(readers, rows).await?;
    let summaries = rows.iter().map(|row| {
        let actuator = actuators.get(&row.number).copied().unwrap_or_default();
        summary(row, totals.get(&row.number), deadline_missed.get(&row.number), actuator)
    });
    summaries.collect()
}

/// Returns the results of the actuators of these runs. A run without such results has the default. Values with the
/// names of these results count no matter which custom code logged them, as in the columns of `data.csv`.
async fn actuator_results(
    readers: &Readers,
    rows: &[RunRow],
) -> Result<HashMap<i64, ActuatorResults>, StoreError> {
    let numbers: Vec<i64> = rows.iter().map(|row| row.number).collect();
    if numbers.is_empty() {
        return Ok(HashMap::new());
    }
    let mut by_name = HashMap::new();
    for name in EPISODE_VALUES.into_iter().chain([SUPERSEDED]) {
        by_name.insert(name, statistics::whole_runs(readers, &numbers, name).await?);
    }
    let results = |number: &i64| {
        ActuatorResults::from_statistics(|name| {
            let statistics = by_name.get(name)?.get(number)?.statistics()?;
            Some((statistics.count, statistics.mean, statistics.std))
        })
    };
    Ok(numbers.iter().map(|number| (*number, results(number))).collect())
}

/// Returns the summaries of `DEADLINE_MISSED` for the runs with a deadline. Each successful iteration has the value 1
/// if it missed the deadline, and 0 otherwise.
async fn deadline_missed_summaries(
    readers: &Readers,
    rows: &[RunRow],
) -> Result<HashMap<i64, NameSummary>, StoreError> {
    let with_deadline = rows.iter().filter(|row| deadline_s(&row.configuration).is_some());
    let numbers: Vec<i64> = with_deadline.map(|row| row.number).collect();
    if numbers.is_empty() {
        return Ok(HashMap::new());
    }
    statistics::whole_runs(readers, &numbers, DEADLINE_MISSED).await
}

/// Reads the deadline in seconds from the pipeline's table of the configuration. In the text that the agent writes, the
/// keys of the table precede its sub-tables.
fn deadline_s(configuration: &str) -> Option<f64> {
    // The text is not parsed as TOML: only this line is needed, and a list has many runs.
    let keys = configuration.lines().take_while(|line| !line.starts_with('['));
    let milliseconds = keys.filter_map(|line| line.strip_prefix("deadline_ms = ")).next()?;
    milliseconds.parse::<u64>().ok().map(|milliseconds| milliseconds as f64 / 1e3)
}

pub(crate) async fn run(readers: &Readers, number: i64) -> Result<Option<RunDetail>, StoreError> {
    let row: Option<RunRow> = sqlx::query_as(sql::RUN)
        .bind(number)
        .fetch_optional(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let Some(row) = row else { return Ok(None) };
    let totals = statistics::whole_runs(readers, &[number], &stage::TOTAL).await?;
    let deadline_missed = deadline_missed_summaries(readers, std::slice::from_ref(&row)).await?;
    let actuators = actuator_results(readers, std::slice::from_ref(&row)).await?;
    let actuator = actuators.get(&number).copied().unwrap_or_default();
    Ok(Some(RunDetail {
        summary: summary(&row, totals.get(&number), deadline_missed.get(&number), actuator)?,
        facts: facts(&row)?,
        conditions: row.conditions.as_deref().map(parse_json).transpose()?.unwrap_or_default(),
        // Earlier versions stored the arguments of programs, which may contain secrets.
        configuration: hide_arguments(&row.configuration),
        version: row.version,
        gaps: gaps(readers, number).await?,
    }))
}

/// Returns the gaps of a run, oldest first. Gaps after the first 1,000 are combined into few rows, so that the sum over
/// the rows counts all missing events.
pub(crate) async fn gaps(readers: &Readers, run: i64) -> Result<Vec<GapRow>, StoreError> {
    type Row = (i64, i64, i64, String, i64);
    let first: Vec<Row> = sqlx::query_as(sql::GAPS)
        .bind(run)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for("gaps"))?;
    let further: Vec<Row> = sqlx::query_as(sql::FURTHER_GAPS)
        .bind(run)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for("gaps"))?;
    let row = |(from, to, missing, reason, gaps): Row| GapRow {
        from: wall(from),
        to: wall(to),
        count: count(missing),
        reason,
        gaps: count(gaps),
    };
    Ok(first.into_iter().chain(further).map(row).collect())
}

fn facts(row: &RunRow) -> Result<Vec<(String, String)>, StoreError> {
    let mut facts: Vec<(String, String)> = parse_json(&row.facts)?;
    hide_arguments_in_facts(&mut facts);
    Ok(facts)
}

fn parse_json<T: DeserializeOwned>(text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(|error| corrupt_data(WHAT, error))
}

fn summary(
    row: &RunRow,
    total: Option<&NameSummary>,
    deadline_missed: Option<&NameSummary>,
    actuator: ActuatorResults,
) -> Result<RunSummary, StoreError> {
    // The column `placement` has the name of the kind.
    let kind = [PlacementKind::Local, PlacementKind::Remote, PlacementKind::None]
        .into_iter()
        .find(|kind| kind.name() == row.placement)
        .ok_or_else(|| corrupt_data(WHAT, format_args!("placement {:?}", row.placement)))?;
    let deadline_s = deadline_s(&row.configuration);
    // The values are ones and zeros, so their sum is the number of late iterations.
    let late = deadline_missed.map_or(0.0, |missed| missed.summary.moments.sum());
    let counts = OutcomeCounts {
        ok: count(row.ok),
        failed: count(row.failed),
        lost: count(row.lost),
        timeout: count(row.timeout),
    };
    Ok(RunSummary {
        number: row.number,
        id: parse(WHAT, &row.uuid)?,
        host: parse(WHAT, &row.host_uuid)?,
        host_name: parse(WHAT, row.host_name.as_deref().unwrap_or(UNKNOWN))?,
        pipeline: parse(WHAT, &row.pipeline)?,
        placement: Placement {
            kind,
            peer: parse_name(WHAT, row.peer.as_deref())?,
            network: row.network.clone(),
            address: row.address.clone(),
            model: parse(WHAT, &row.model)?,
            device: row.device.clone(),
        },
        started: wall(row.started_ns),
        ended: row.ended_ns.map(WallTime::from_unix_nanos),
        reason: row.end_reason.clone().map(EndReason::from),
        last_iteration: row.last_iteration_ns.map(WallTime::from_unix_nanos),
        counts,
        warm_up: count(row.warm_up),
        skipped_starts: count(row.skipped_starts),
        deadline_s,
        misses: deadline_s.map(|_| Misses::new(counts.ok, late.round() as u64, counts.all_failed())),
        actuator,
        total: total.and_then(NameSummary::statistics),
        has_clock_fault: facts(row)?.iter().any(|(fact, _)| FaultyHost::from_fact_name(fact).is_some()),
        pinned: row.pinned,
        // Despite its name, the column has the number of the last deleted iteration.
        last_deleted_iteration: count(row.nodes_from),
        experiment: row.experiment.as_deref().map(parse_json).transpose()?,
    })
}
