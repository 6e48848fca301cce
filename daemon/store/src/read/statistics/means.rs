//! Means of stages over the time of a run. SQLite adds up the values, and no sketch is read.

use peernet_logger::Name;

use super::super::{sql, wall};
use super::WHAT;
use super::series::{NameIds, StoredWidths};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::{MeanBucket, StageMeans};

/// A row of `SUMS_OVER_TIME`: id of the name, index of the point, number of values, sum of the values.
type Row = (i64, i64, i64, f64);

pub(crate) async fn stage_means(
    readers: &Readers,
    run: i64,
    stages: &[Name],
    max_buckets: usize,
) -> Result<Vec<StageMeans>, StoreError> {
    let (width_s, stored_width_s) = StoredWidths::read(readers, run).await?.choose(max_buckets);
    let name_ids = NameIds::read(readers, stages).await?;
    let rows: Vec<Row> = sqlx::query_as(sql::SUMS_OVER_TIME)
        .bind(run)
        .bind(stored_width_s)
        .bind(name_ids.ids()?)
        .bind(width_s)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    // For each stage, the list has an entry for each point: index of the point, number of values, sum of the values. A
    // name whose nodes have several kinds (a timer, a value) has several ids, and a row with each id for one point.
    // These rows are added.
    let mut sums: Vec<Vec<(i64, u64, f64)>> = vec![Vec::new(); stages.len()];
    for (name, point, count, sum) in rows {
        let Some(points) = name_ids.indexes.get(&name).and_then(|index| sums.get_mut(*index)) else {
            continue;
        };
        let count = u64::try_from(count).unwrap_or_default();
        match points.last_mut() {
            Some((last_point, total_count, total_sum)) if *last_point == point => {
                (*total_count, *total_sum) = (*total_count + count, *total_sum + sum);
            }
            _ => points.push((point, count, sum)),
        }
    }
    let mean = |(point, count, sum): &(i64, u64, f64)| {
        let at = wall(point.saturating_mul(width_s).saturating_mul(1_000_000_000));
        (*count > 0).then(|| MeanBucket { at, count: *count, mean: sum / *count as f64 })
    };
    let means = stages.iter().zip(sums).map(|(stage, points)| StageMeans {
        stage: stage.clone(),
        buckets: points.iter().filter_map(mean).collect(),
    });
    Ok(means.filter(|means| !means.buckets.is_empty()).collect())
}
