//! Statistics over the time of a run, from buckets of a suitable width. The number of rows that are read depends on the
//! number of points and names, not on the length of the run.

use std::collections::HashMap;

use futures::TryStreamExt as _;
use peernet_clock::{Span, WallTime};
use peernet_logger::Name;
use peernet_statistics::{BUCKET_WIDTHS_S, Summary};

use super::super::{corrupt_data, runs, sql, wall};
use super::WHAT;
use crate::error::StoreError;
use crate::quantity_statistics::QuantityStatistics;
use crate::readers::Readers;
use crate::rollups::{RollupRow, WIDTHS_S, bucket};
use crate::types::{Series, SeriesPoint, StageBuckets, StageSeries};

const DAY_S: i64 = 86_400;

pub(crate) async fn series(
    readers: &Readers,
    run: i64,
    stages: &[Name],
    max_points: usize,
) -> Result<Series, StoreError> {
    let stored = StoredWidths::read(readers, run).await?;
    let (width_s, stored_width_s) = stored.choose(max_points);
    let bucket_s = u32::try_from(width_s).unwrap_or(u32::MAX);
    let stages = points(readers, run, stages, (width_s, stored_width_s)).await?;
    let mut gaps = runs::gaps(readers, run).await?;
    // A chart marks the time of each gap. A row that combines several gaps also spans events that were recorded.
    gaps.retain(|gap| gap.gaps == 1);
    Ok(Series { bucket_s, stages, gaps })
}

/// The buckets of one width that are stored for a run.
#[derive(Clone, Copy, Debug)]
struct StoredWidth {
    width_s: i64,
    /// Starts of the first and of the last stored bucket; `None` without a bucket.
    extent: Option<(i64, i64)>,
    /// `true` if no bucket of this width was deleted.
    is_complete: bool,
}

/// The widths of buckets that are stored for a run.
pub(in crate::read) struct StoredWidths([StoredWidth; WIDTHS_S.len()]);

impl StoredWidths {
    pub(in crate::read) async fn read(readers: &Readers, run: i64) -> Result<Self, StoreError> {
        // One statement reads all widths, because a page of a hundred runs calls this function hundreds of times.
        let extents: Vec<(i64, Option<i64>, Option<i64>, bool)> = sqlx::query_as(sql::WIDTH_EXTENTS)
            .bind(run)
            .bind(serde_json::to_string(&WIDTHS_S).map_err(|error| corrupt_data(WHAT, error))?)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        let mut widths = WIDTHS_S.map(|width_s| StoredWidth { width_s, extent: None, is_complete: true });
        for (width_s, first, last, is_trimmed) in extents {
            if let Some(width) = widths.iter_mut().find(|width| width.width_s == width_s) {
                (width.extent, width.is_complete) = (first.zip(last), !is_trimmed);
            }
        }
        Ok(Self(widths))
    }

    /// Returns the finest width of which no bucket was deleted, with the starts of its first and its last bucket.
    /// `None` if no such width has a bucket.
    pub(in crate::read) fn finest_complete(&self) -> Option<(i64, (i64, i64))> {
        self.0.iter().filter(|width| width.is_complete).find_map(|width| Some((width.width_s, width.extent?)))
    }

    /// Chooses the width of a chart's points and the stored width of the buckets from which the points are made.
    /// Returns both widths.
    ///
    /// The width of a point is the smallest width with which the whole run has at most `max_points` points. The stored
    /// width is the coarsest stored width that divides the width of a point. If buckets of this stored width were
    /// deleted, the next greater width of a point is tried, so that all points of a line are made from one stored
    /// width. Buckets of an hour are the exception: the remaining buckets are used even if some buckets were deleted.
    pub(super) fn choose(&self, max_points: usize) -> (i64, i64) {
        let complete_extent = self.0.iter().filter(|width| width.is_complete).find_map(|width| width.extent);
        let remaining_extent = || {
            let extents = self.0.iter().filter_map(|width| width.extent);
            extents.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
        };
        // The number of points depends on the duration of the whole run. The buckets of a width with deleted buckets
        // cover only a part of this duration.
        let (from, to) = complete_extent.or_else(remaining_extent).unwrap_or((0, 0));
        let max_points = i64::try_from(max_points.max(1)).unwrap_or(i64::MAX);
        let hour = WIDTHS_S[WIDTHS_S.len() - 1];
        for width_s in BUCKET_WIDTHS_S.map(i64::from) {
            let fits = to.div_euclid(width_s) - from.div_euclid(width_s) < max_points;
            let stored = self.0.iter().rfind(|stored| width_s % stored.width_s == 0);
            let is_usable = |stored: &&StoredWidth| stored.is_complete || stored.width_s == hour;
            if let Some(stored) = stored.filter(|stored| fits && is_usable(stored)) {
                return (width_s, stored.width_s);
            }
        }
        // No run takes as long as this range: a clock was wrong. The width is a whole number of days.
        // One of the two added days rounds up; the other is for a range that does not begin at a multiple of the width.
        (((to - from) / max_points / DAY_S + 2) * DAY_S, hour)
    }
}

/// Returns the points of each name that has points, in the order of `stages`.
async fn points(
    readers: &Readers,
    run: i64,
    stages: &[Name],
    widths: (i64, i64),
) -> Result<Vec<StageSeries>, StoreError> {
    let builders = series_builders(readers, run, stages, widths).await?;
    let series = builders.into_iter().map(|builder| StageSeries {
        points: builder.buckets.iter().filter_map(point).collect(),
        stage: builder.stage,
        unit: builder.unit,
    });
    Ok(series.filter(|series| !series.points.is_empty()).collect())
}

/// Does the same as [`series`], but returns the summary of each bucket instead of its statistics.
pub(crate) async fn stage_buckets(
    readers: &Readers,
    run: i64,
    stages: &[Name],
    max_buckets: usize,
) -> Result<Vec<StageBuckets>, StoreError> {
    let widths = StoredWidths::read(readers, run).await?.choose(max_buckets);
    let builders = series_builders(readers, run, stages, widths).await?;
    let stage_buckets = builders.into_iter().map(|builder| {
        let (starts_s, buckets): (Vec<_>, Vec<_>) = builder.buckets.into_iter().unzip();
        StageBuckets {
            buckets,
            bucket_starts: starts_s.into_iter().map(bucket_start).collect(),
            bucket_width: Span::from_seconds(widths.0),
            stage: builder.stage,
            unit: builder.unit,
        }
    });
    Ok(stage_buckets.filter(|stage| !stage.buckets.is_empty()).collect())
}

/// Reads the buckets of each stage. Returns one builder per stage, in the order of `stages`.
async fn series_builders(
    readers: &Readers,
    run: i64,
    stages: &[Name],
    (width_s, stored_width_s): (i64, i64),
) -> Result<Vec<SeriesBuilder>, StoreError> {
    let name_ids = NameIds::read(readers, stages).await?;
    let builder = |(index, stage): (usize, &Name)| SeriesBuilder {
        stage: stage.clone(),
        unit: name_ids.units[index].clone(),
        width_s,
        buckets: Vec::new(),
    };
    let mut builders: Vec<SeriesBuilder> = stages.iter().enumerate().map(builder).collect();
    let pool = readers.pool();
    let mut rows = sqlx::query_as::<_, RollupRow>(sql::ROLLUPS_OVER_TIME)
        .bind(run)
        .bind(stored_width_s)
        .bind(name_ids.ids()?)
        .fetch(&pool);
    while let Some(row) = rows.try_next().await.map_err(readers.error_for(WHAT))? {
        let builder = name_ids.indexes.get(&row.name).and_then(|index| builders.get_mut(*index));
        if let Some(builder) = builder {
            builder.add(&row)?;
        }
    }
    Ok(builders)
}

/// Ids and units of some names in the database.
pub(in crate::read) struct NameIds {
    /// For each id, the index of its name in the list that was passed to [`NameIds::read`]. A name with several kinds
    /// of measure has several ids; the values of these ids are merged.
    pub(super) indexes: HashMap<i64, usize>,
    /// Unit of each name, in the order of that list.
    units: Vec<String>,
}

impl NameIds {
    pub(in crate::read) async fn read(readers: &Readers, stages: &[Name]) -> Result<Self, StoreError> {
        let texts: Vec<&str> = stages.iter().map(|stage| &**stage).collect();
        let names: Vec<(i64, String, String)> = sqlx::query_as(sql::NAMES)
            .bind(serde_json::to_string(&texts).map_err(|error| corrupt_data(WHAT, error))?)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        let mut name_ids = Self { indexes: HashMap::new(), units: vec![String::new(); stages.len()] };
        for (id, text, unit) in names {
            if let Some(index) = texts.iter().position(|requested| *requested == text) {
                name_ids.units[index] = unit;
                name_ids.indexes.insert(id, index);
            }
        }
        Ok(name_ids)
    }

    /// Returns the ids as a JSON array, because statements take lists as JSON.
    pub(in crate::read) fn ids(&self) -> Result<String, StoreError> {
        let ids: Vec<i64> = self.indexes.keys().copied().collect();
        serde_json::to_string(&ids).map_err(|error| corrupt_data(WHAT, error))
    }
}

/// Returns the start of the bucket that begins at this second since the Unix epoch.
fn bucket_start(second: i64) -> WallTime {
    wall(second.saturating_mul(1_000_000_000))
}

/// Converts a bucket to a point; `None` if the bucket has no values.
fn point((start, summary): &(i64, Summary)) -> Option<SeriesPoint> {
    QuantityStatistics::from_summary(summary).map(|statistics| SeriesPoint {
        at: bucket_start(*start),
        count: statistics.count,
        mean: statistics.mean,
        p50: statistics.p50,
        p95: statistics.p95,
    })
}

/// Collects the buckets of one name from rows, which have to be added in the order of time.
struct SeriesBuilder {
    stage: Name,
    unit: String,
    width_s: i64,
    /// Start and summary of each bucket; further rows may be merged into the last bucket.
    buckets: Vec<(i64, Summary)>,
}

impl SeriesBuilder {
    fn add(&mut self, row: &RollupRow) -> Result<(), StoreError> {
        let summary = row.summary().map_err(|error| corrupt_data(WHAT, error))?;
        let start = bucket(row.bucket_s, self.width_s);
        match self.buckets.last_mut() {
            // The rows are in the order of time, so a row belongs to the last bucket or to a new one.
            Some((last_start, total)) if *last_start == start => total.merge(&summary),
            _ => self.buckets.push((start, summary)),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEEK_S: i64 = 7 * DAY_S;

    /// Returns the stored widths of a run that began at the start of an hour and took `length_s` seconds. Some buckets
    /// of the widths in `deleted` were deleted.
    fn stored(length_s: i64, deleted: &[i64]) -> StoredWidths {
        StoredWidths(WIDTHS_S.map(|width_s| StoredWidth {
            width_s,
            extent: Some((0, bucket(length_s - 1, width_s))),
            is_complete: !deleted.contains(&width_s),
        }))
    }

    #[test]
    fn coarsest_stored_width_that_divides_points_is_chosen() {
        for (length_s, points, choice) in [
            (100, 240, (1, 1)),
            (241, 240, (2, 1)),
            (1_200, 240, (5, 1)),
            (2_400, 240, (10, 10)),
            (14_400, 240, (60, 60)),
            (DAY_S, 240, (600, 60)),
            (2 * DAY_S, 240, (900, 60)),
            (WEEK_S, 240, (3_600, 3_600)),
            (WEEK_S, 7, (DAY_S, 3_600)),
        ] {
            assert_eq!(stored(length_s, &[]).choose(points), choice, "{length_s} s in {points} points");
        }
        // Over the longest possible range, which results from an error of a clock, there are also at most 240 points,
        // and the stored width divides the width of a point.
        let (width_s, stored_width_s) = stored(i64::MAX / 1_000_000_000, &[]).choose(240);
        assert!(i64::MAX / 1_000_000_000 / width_s < 240 && width_s % stored_width_s == 0);
    }

    #[test]
    fn width_with_deleted_buckets_is_skipped() {
        assert_eq!(stored(100, &[1]).choose(240), (10, 10));
        assert_eq!(stored(100, &[1, 10]).choose(240), (60, 60));
        assert_eq!(stored(7_200, &[1, 10, 60]).choose(240), (3_600, 3_600));
        // Buckets of an hour are used even if some were deleted.
        assert_eq!(stored(WEEK_S, &[1, 10, 60, 3_600]).choose(240), (3_600, 3_600));
        // A run without buckets gets the smallest widths.
        assert_eq!(
            StoredWidths(stored(0, &[]).0.map(|width| StoredWidth { extent: None, ..width })).choose(240),
            (1, 1)
        );
    }
}
