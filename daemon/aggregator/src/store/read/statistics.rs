//! Figures of runs, from the roll-ups alone: their cost does not depend on the number of nodes.

use std::collections::HashMap;

use peernet_clock::Verdict;
use peernet_logger::{Name, stage};
use peernet_statistics::{Moments, Sketch, Summary};
use sqlx::{FromRow, SqlitePool};

use super::{corrupt, count, failed, runs, sql, wall};
use crate::error::StoreError;
use crate::figures::{Bound, Figures, rank};
use crate::store::types::{Histogram, Series, SeriesPoint, StageSeries, StageStatistics};

const WHAT: &str = "statistics";
/// Widths that a bucket may have, all multiples of the finest stored: 10 s to a day.
const WIDTHS_S: [i64; 9] = [10, 30, 60, 300, 600, 1_800, 3_600, 21_600, 86_400];
/// Width of the stored buckets that series are made of.
const STORED_S: i64 = WIDTHS_S[0];
/// Above this quantile a histogram only counts, so that one straggler does not squeeze all others into a bin.
const AXIS_ENDS_AT: f64 = 0.99;
/// The axis goes on beyond that quantile by this share of its length.
const AXIS_MARGIN: f64 = 0.1;

#[derive(FromRow)]
struct RollupRow {
    text: String,
    unit: String,
    quantity: i64,
    bucket_s: i64,
    count: i64,
    mean: f64,
    m2: f64,
    min: f64,
    max: f64,
    sketch: Vec<u8>,
}

/// What is known of one name over a run or a bucket.
pub(super) struct Known {
    unit: String,
    summary: Summary,
}

impl Known {
    pub(super) fn figures(&self) -> Option<Figures> {
        Figures::of(&self.summary)
    }
}

impl RollupRow {
    fn summary(&self) -> Result<Summary, StoreError> {
        let sketch = Sketch::from_bytes(&self.sketch).map_err(|error| corrupt(WHAT, error))?;
        let moments =
            Moments { count: count(self.count), mean: self.mean, m2: self.m2, min: self.min, max: self.max };
        Ok(Summary { moments, sketch })
    }
}

/// One name over a whole run. A name that was used with several kinds is taken together.
pub(super) async fn whole_run(pool: &SqlitePool, run: i64, name: &str) -> Result<Option<Known>, StoreError> {
    let rows: Vec<RollupRow> = sqlx::query_as(sql::ROLLUP_OF_NAME)
        .bind(run)
        .bind(name)
        .fetch_all(pool)
        .await
        .map_err(failed(WHAT))?;
    let mut known: Option<Known> = None;
    for row in rows {
        let summary = row.summary()?;
        match &mut known {
            Some(known) => known.summary.merge(&summary),
            None => known = Some(Known { unit: row.unit, summary }),
        }
    }
    Ok(known)
}

pub(in crate::store) async fn stages(
    pool: &SqlitePool,
    run: i64,
) -> Result<Vec<StageStatistics>, StoreError> {
    let rows: Vec<RollupRow> =
        sqlx::query_as(sql::ROLLUPS).bind(run).fetch_all(pool).await.map_err(failed(WHAT))?;
    let mut values = HashMap::<Name, Known>::new();
    let mut half_widths = HashMap::<Name, Summary>::new();
    for row in rows {
        let summary = row.summary()?;
        let name = Name::from(row.text);
        if row.quantity == 0 {
            let known =
                values.entry(name).or_insert_with(|| Known { unit: row.unit, summary: Summary::default() });
            known.summary.merge(&summary);
        } else {
            half_widths.entry(name).or_default().merge(&summary);
        }
    }
    let mut bounds = joined(verdicts(pool, run).await?, half_widths);
    let sum = |known: &Known| known.summary.moments.mean * known.summary.moments.count as f64;
    let total = values.get(stage::TOTAL.as_str()).map(sum).filter(|total| *total > 0.0);
    let mut statistics: Vec<StageStatistics> = values
        .into_iter()
        .filter_map(|(stage, known)| {
            Some(StageStatistics {
                is_stage: stage::ORDER.contains(&stage),
                figures: known.figures()?,
                share: total.filter(|_| known.unit == "s").map(|total| sum(&known) / total),
                bound: bounds.remove(&stage),
                unit: known.unit,
                stage,
            })
        })
        .collect();
    statistics.sort_by(|a, b| rank(&a.stage).cmp(&rank(&b.stage)));
    Ok(statistics)
}

/// The one-way delays of a run, those included of which no value is known.
pub(in crate::store) async fn bounds(pool: &SqlitePool, run: i64) -> Result<Vec<Bound>, StoreError> {
    let rows: Vec<RollupRow> =
        sqlx::query_as(sql::ROLLUPS).bind(run).fetch_all(pool).await.map_err(failed(WHAT))?;
    let mut half_widths = HashMap::<Name, Summary>::new();
    for row in rows.into_iter().filter(|row| row.quantity != 0) {
        let summary = row.summary()?;
        half_widths.entry(Name::from(row.text)).or_default().merge(&summary);
    }
    let mut bounds: Vec<Bound> = joined(verdicts(pool, run).await?, half_widths).into_values().collect();
    bounds.sort_by(|a, b| rank(&a.stage).cmp(&rank(&b.stage)));
    Ok(bounds)
}

fn joined(mut bounds: HashMap<Name, Bound>, half_widths: HashMap<Name, Summary>) -> HashMap<Name, Bound> {
    for (stage, summary) in half_widths {
        let bound = bounds.entry(stage.clone()).or_insert_with(|| Bound {
            stage,
            half_width: None,
            verdicts: vec![],
        });
        bound.half_width = Figures::of(&summary);
    }
    bounds
}

async fn verdicts(pool: &SqlitePool, run: i64) -> Result<HashMap<Name, Bound>, StoreError> {
    let rows: Vec<(String, i64, i64)> =
        sqlx::query_as(sql::VERDICTS).bind(run).fetch_all(pool).await.map_err(failed(WHAT))?;
    let mut bounds = HashMap::<Name, Bound>::new();
    for (text, number, times) in rows {
        let stage = Name::from(text);
        let verdict = usize::try_from(number).ok().and_then(|at| Verdict::ALL.get(at).copied());
        let verdict = verdict.ok_or_else(|| corrupt(WHAT, format_args!("verdict {number}")))?;
        let bound = bounds.entry(stage.clone()).or_insert_with(|| Bound {
            stage,
            half_width: None,
            verdicts: vec![],
        });
        bound.verdicts.push((verdict, count(times)));
    }
    Ok(bounds)
}

pub(in crate::store) async fn histogram(
    pool: &SqlitePool,
    run: i64,
    stage: &str,
    bins: usize,
) -> Result<Option<Histogram>, StoreError> {
    let Some(known) = whole_run(pool, run, stage).await? else { return Ok(None) };
    let Some(figures) = known.figures() else { return Ok(None) };
    let bins = bins.clamp(1, 500);
    let low = figures.min;
    let typical = known.summary.quantile(AXIS_ENDS_AT).unwrap_or(figures.max);
    let high = (typical + (typical - low) * AXIS_MARGIN).min(figures.max);
    // All samples equal: one bin of a width that can be drawn.
    let high = if high > low { high } else { low + low.abs().max(1e-9) * 0.01 };
    let edges: Vec<f64> = (0..=bins).map(|at| low + (high - low) * at as f64 / bins as f64).collect();
    // Extremes are exact, the sketch's bins are not: what it sees outside the first edge belongs to the first bin.
    let mut sums: Vec<f64> = edges.iter().map(|edge| known.summary.sketch.count_below(*edge)).collect();
    if let Some(first) = sums.first_mut() {
        *first = 0.0;
    }
    let beyond_starts =
        if high < figures.max { sums.last().copied().unwrap_or(0.0) } else { figures.count as f64 };
    if let Some(last) = sums.last_mut() {
        *last = beyond_starts;
    }
    // Sums are rounded, not bins: the bins then add up to the number of samples.
    let rounded: Vec<u64> = sums.iter().map(|sum| (sum.round() as u64).min(figures.count)).collect();
    let counts: Vec<u64> = rounded.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    let beyond = figures.count - counts.iter().sum::<u64>().min(figures.count);
    Ok(Some(Histogram { stage: stage.into(), unit: known.unit, edges, counts, beyond, figures }))
}

pub(in crate::store) async fn series(
    pool: &SqlitePool,
    run: i64,
    stages: &[Name],
    max_points: usize,
) -> Result<Series, StoreError> {
    let mut extent: Option<(i64, i64)> = None;
    for stage in stages {
        let row: (Option<i64>, Option<i64>) = sqlx::query_as(sql::EXTENT)
            .bind(run)
            .bind(STORED_S)
            .bind(stage.as_str())
            .fetch_one(pool)
            .await
            .map_err(failed(WHAT))?;
        if let (Some(first), Some(last)) = row {
            let (from, to) = extent.unwrap_or((first, last));
            extent = Some((from.min(first), to.max(last)));
        }
    }
    let (from, to) = extent.unwrap_or((0, 0));
    let most = i64::try_from(max_points.max(1)).unwrap_or(i64::MAX);
    let fits = |width: &i64| to.div_euclid(*width) - from.div_euclid(*width) < most;
    let width = WIDTHS_S.into_iter().find(fits).unwrap_or(WIDTHS_S[WIDTHS_S.len() - 1]);
    let mut all = Vec::with_capacity(stages.len());
    for stage in stages {
        if let Some(series) = one_series(pool, run, stage, width).await? {
            all.push(series);
        }
    }
    let bucket_s = u32::try_from(width).unwrap_or(u32::MAX);
    Ok(Series { bucket_s, stages: all, gaps: runs::gaps(pool, run).await? })
}

async fn one_series(
    pool: &SqlitePool,
    run: i64,
    stage: &Name,
    width: i64,
) -> Result<Option<StageSeries>, StoreError> {
    let rows: Vec<RollupRow> = sqlx::query_as(sql::ROLLUPS_OVER_TIME)
        .bind(run)
        .bind(stage.as_str())
        .bind(STORED_S)
        .fetch_all(pool)
        .await
        .map_err(failed(WHAT))?;
    let Some(unit) = rows.first().map(|row| row.unit.clone()) else { return Ok(None) };
    let mut points = Vec::new();
    for rows in rows.chunk_by(|a, b| a.bucket_s.div_euclid(width) == b.bucket_s.div_euclid(width)) {
        let mut summary = Summary::default();
        for row in rows {
            summary.merge(&row.summary()?);
        }
        let at = rows.first().map_or(0, |row| row.bucket_s.div_euclid(width) * width);
        if let Some(figures) = Figures::of(&summary) {
            points.push(SeriesPoint {
                at: wall(at.saturating_mul(1_000_000_000)),
                count: figures.count,
                mean: figures.mean,
                p50: figures.p50,
                p95: figures.p95,
            });
        }
    }
    Ok(Some(StageSeries { stage: stage.clone(), unit, points }))
}

/// Figures of all names of a run, in the order of tables.
pub(super) async fn figures(pool: &SqlitePool, run: i64) -> Result<Vec<(Name, Figures)>, StoreError> {
    Ok(stages(pool, run).await?.into_iter().map(|known| (known.stage, known.figures)).collect())
}
