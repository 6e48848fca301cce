//! Statistics of runs, computed only from roll-ups. The cost of these queries therefore does not depend on the number
//! of nodes.

mod means;
mod runs;
mod series;

use std::collections::HashMap;

use peernet_logger::Name;
use peernet_statistics::histogram::{BinCounts, Binning};
use peernet_statistics::{Moments, Sketch, Summary};
use sqlx::FromRow;

use super::{corrupt_data, count, sql};
use crate::error::StoreError;
use crate::quantity_statistics::QuantityStatistics;
use crate::readers::Readers;
use crate::types::{Histogram, NameSummary};

pub(crate) use self::means::stage_means;
pub(crate) use self::runs::statistics;
pub(super) use self::series::{NameIds, StoredWidths};
pub(crate) use self::series::{series, stage_buckets};

/// Name of the requested data in errors.
const WHAT: &str = "statistics";

/// Roll-up of one name and quantity over a whole run.
#[derive(FromRow)]
struct WholeRunRollup {
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

impl WholeRunRollup {
    fn summary(&self) -> Result<Summary, StoreError> {
        let sketch = Sketch::from_bytes(&self.sketch).map_err(|error| corrupt_data(WHAT, error))?;
        let moments =
            Moments { count: count(self.count), mean: self.mean, m2: self.m2, min: self.min, max: self.max };
        Ok(Summary { moments, sketch })
    }
}

/// Returns the summary of one name in each of some runs; runs without values of this name are absent. If nodes with
/// this name have several kinds of measure, the values of all kinds are merged.
pub(super) async fn whole_runs(
    readers: &Readers,
    runs: &[i64],
    name: &str,
) -> Result<HashMap<i64, NameSummary>, StoreError> {
    let rows: Vec<WholeRunRollup> = sqlx::query_as(sql::ROLLUPS_OF_NAME)
        .bind(json_array(runs)?)
        .bind(name)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let mut by_run = HashMap::<i64, NameSummary>::new();
    for row in rows {
        let summary = row.summary()?;
        by_run.entry(row.run).or_insert_with(|| NameSummary::with_unit(&row.unit)).summary.merge(&summary);
    }
    Ok(by_run)
}

/// Converts numbers to a JSON array, because statements take lists as JSON.
fn json_array(numbers: &[i64]) -> Result<String, StoreError> {
    serde_json::to_string(numbers).map_err(|error| corrupt_data(WHAT, error))
}

pub(crate) async fn histogram(
    readers: &Readers,
    run: i64,
    stage: &str,
    max_bins: usize,
) -> Result<Option<Histogram>, StoreError> {
    let Some(values) = whole_runs(readers, &[run], stage).await?.remove(&run) else { return Ok(None) };
    let Some(statistics) = values.statistics() else { return Ok(None) };
    let Some(binning) = Binning::of(&values.summary, max_bins) else { return Ok(None) };
    let (stage, edges) = (stage.into(), binning.edges());
    let BinCounts { below, counts, above } = values.summary.count_in(&edges, binning.range);
    Ok(Some(Histogram { stage, unit: values.unit, edges, counts, below, beyond: above, statistics }))
}

/// Returns the statistics of all names of a run, in the order in which tables list the names.
pub(super) async fn statistics_by_name(
    readers: &Readers,
    run: i64,
) -> Result<Vec<(Name, QuantityStatistics)>, StoreError> {
    let runs = statistics(readers, &[run]).await?;
    Ok(runs.into_iter().flat_map(|run| run.stages).map(|entry| (entry.stage, entry.statistics)).collect())
}
