//! Statistics of runs, from the roll-ups alone. The cost of these queries does not depend on the number of nodes.

mod means;
mod runs;
mod series;

use std::collections::HashMap;

use peernet_logger::Name;
use peernet_statistics::{Moments, Sketch, Summary};
use sqlx::FromRow;

use super::{corrupt_data, count, sql};
use crate::error::StoreError;
use crate::figures::QuantityStatistics;
use crate::readers::Readers;
use crate::types::{Histogram, NameSummary};

pub(crate) use self::means::stage_means;
pub(crate) use self::runs::statistics;
pub(super) use self::series::{NameIds, StoredWidths};
pub(crate) use self::series::{series, stage_buckets};

const WHAT: &str = "statistics";

#[derive(FromRow)]
struct RollupRow {
    run: i64,
    text: String,
    unit: String,
    quantity: i64,
    count: i64,
    mean: f64,
    m2: f64,
    min: f64,
    max: f64,
    sketch: Vec<u8>,
}

impl RollupRow {
    fn summary(&self) -> Result<Summary, StoreError> {
        let sketch = Sketch::from_bytes(&self.sketch).map_err(|error| corrupt_data(WHAT, error))?;
        let moments =
            Moments { count: count(self.count), mean: self.mean, m2: self.m2, min: self.min, max: self.max };
        Ok(Summary { moments, sketch })
    }
}

/// Returns the summary of one name over whole runs, by run. Values of a name that was used with several kinds are merged.
pub(super) async fn whole_runs(
    readers: &Readers,
    runs: &[i64],
    name: &str,
) -> Result<HashMap<i64, NameSummary>, StoreError> {
    let rows: Vec<RollupRow> = sqlx::query_as(sql::ROLLUPS_OF_NAME)
        .bind(json_array(runs)?)
        .bind(name)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let mut by_run = HashMap::<i64, NameSummary>::new();
    for row in rows {
        let summary = row.summary()?;
        by_run.entry(row.run).or_insert_with(|| NameSummary::with_unit(&row.unit)).summary.merge(&summary);
    }
    Ok(by_run)
}

/// Converts numbers to a JSON array, the form in which statements take a list.
fn json_array(numbers: &[i64]) -> Result<String, StoreError> {
    serde_json::to_string(numbers).map_err(|error| corrupt_data(WHAT, error))
}

pub(crate) async fn histogram(
    readers: &Readers,
    run: i64,
    stage: &str,
    bins: usize,
) -> Result<Option<Histogram>, StoreError> {
    let Some(samples) = whole_runs(readers, &[run], stage).await?.remove(&run) else { return Ok(None) };
    let Some(figures) = samples.figures() else { return Ok(None) };
    let bins = bins.clamp(1, 500);
    let low = figures.min;
    let extend = |low: f64, quantile: f64, factor: f64| low + (quantile - low) * factor;
    let high = samples.summary.axis_end(low, extend).unwrap_or(figures.max);
    // If all samples are equal, the bin gets a width that can be drawn.
    let high = if high > low { high } else { low + low.abs().max(1e-9) * 0.01 };
    let edges: Vec<f64> = (0..=bins).map(|index| low + (high - low) * index as f64 / bins as f64).collect();
    let mut limits = edges.clone();
    // If the axis ends at the maximum, no sample is beyond the axis.
    if let Some(last) = limits.last_mut()
        && high >= figures.max
    {
        *last = f64::INFINITY;
    }
    // The cumulative counts are rounded instead of the bins, so that the bins add up to the number of samples.
    let (mut below, mut rounded_below) = (0.0, 0);
    let counts = samples.summary.histogram(&limits).into_iter().map(|count| {
        below += count;
        let rounded = (f64::round(below) as u64).min(figures.count);
        rounded - std::mem::replace(&mut rounded_below, rounded)
    });
    let counts: Vec<u64> = counts.collect();
    let beyond = figures.count - counts.iter().sum::<u64>().min(figures.count);
    Ok(Some(Histogram { stage: stage.into(), unit: samples.unit, edges, counts, beyond, figures }))
}

/// Returns the statistics of all names of a run, in the order of tables.
pub(super) async fn statistics_by_name(
    readers: &Readers,
    run: i64,
) -> Result<Vec<(Name, QuantityStatistics)>, StoreError> {
    let runs = statistics(readers, &[run]).await?;
    Ok(runs.into_iter().flat_map(|run| run.stages).map(|entry| (entry.stage, entry.figures)).collect())
}
