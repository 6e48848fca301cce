//! Figures of runs, from the roll-ups alone: their cost does not depend on the number of nodes.

mod means;
mod series;

use std::collections::HashMap;

use peernet_clock::Verdict;
use peernet_logger::{Name, stage};
use peernet_statistics::{Moments, Sketch, Summary};
use sqlx::FromRow;

use super::{corrupt, count, sql};
use crate::error::StoreError;
use crate::figures::{Bound, Figures, rank};
use crate::store::readers::Readers;
use crate::store::types::{Histogram, StageStatistics};

pub(in crate::store) use self::means::means;
pub(in crate::store) use self::series::{course, series};

const WHAT: &str = "statistics";
/// Above this quantile a histogram only counts, so that one straggler does not squeeze all others into a bin.
const AXIS_ENDS_AT: f64 = 0.99;
/// The axis goes on beyond that quantile by this share of its length.
const AXIS_MARGIN: f64 = 0.1;

#[derive(FromRow)]
struct RollupRow {
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
pub(super) async fn whole_run(readers: &Readers, run: i64, name: &str) -> Result<Option<Known>, StoreError> {
    let rows: Vec<RollupRow> = sqlx::query_as(sql::ROLLUP_OF_NAME)
        .bind(run)
        .bind(name)
        .fetch_all(&readers.pool)
        .await
        .map_err(readers.failed(WHAT))?;
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
    readers: &Readers,
    run: i64,
) -> Result<Vec<StageStatistics>, StoreError> {
    let rows: Vec<RollupRow> = sqlx::query_as(sql::ROLLUPS)
        .bind(run)
        .fetch_all(&readers.pool)
        .await
        .map_err(readers.failed(WHAT))?;
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
    let mut bounds = joined(verdicts(readers, run).await?, half_widths);
    let sum = |known: &Known| known.summary.moments.sum();
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
pub(in crate::store) async fn bounds(readers: &Readers, run: i64) -> Result<Vec<Bound>, StoreError> {
    let rows: Vec<RollupRow> = sqlx::query_as(sql::ROLLUPS)
        .bind(run)
        .fetch_all(&readers.pool)
        .await
        .map_err(readers.failed(WHAT))?;
    let mut half_widths = HashMap::<Name, Summary>::new();
    for row in rows.into_iter().filter(|row| row.quantity != 0) {
        let summary = row.summary()?;
        half_widths.entry(Name::from(row.text)).or_default().merge(&summary);
    }
    let mut bounds: Vec<Bound> = joined(verdicts(readers, run).await?, half_widths).into_values().collect();
    bounds.sort_by(|a, b| rank(&a.stage).cmp(&rank(&b.stage)));
    Ok(bounds)
}

fn joined(mut bounds: HashMap<Name, Bound>, half_widths: HashMap<Name, Summary>) -> HashMap<Name, Bound> {
    for (stage, summary) in half_widths {
        bound_of(&mut bounds, stage).half_width = Figures::of(&summary);
    }
    bounds
}

/// The bound of a direction, made when missing.
fn bound_of(bounds: &mut HashMap<Name, Bound>, stage: Name) -> &mut Bound {
    let unknown = |stage: &Name| Bound { stage: stage.clone(), half_width: None, verdicts: Vec::new() };
    bounds.entry(stage).or_insert_with_key(unknown)
}

async fn verdicts(readers: &Readers, run: i64) -> Result<HashMap<Name, Bound>, StoreError> {
    let rows: Vec<(String, i64, i64)> = sqlx::query_as(sql::VERDICTS)
        .bind(run)
        .fetch_all(&readers.pool)
        .await
        .map_err(readers.failed(WHAT))?;
    let mut bounds = HashMap::<Name, Bound>::new();
    for (text, number, times) in rows {
        let stage = Name::from(text);
        let verdict = usize::try_from(number).ok().and_then(|at| Verdict::ALL.get(at).copied());
        let verdict = verdict.ok_or_else(|| corrupt(WHAT, format_args!("verdict {number}")))?;
        bound_of(&mut bounds, stage).verdicts.push((verdict, count(times)));
    }
    Ok(bounds)
}

pub(in crate::store) async fn histogram(
    readers: &Readers,
    run: i64,
    stage: &str,
    bins: usize,
) -> Result<Option<Histogram>, StoreError> {
    let Some(known) = whole_run(readers, run, stage).await? else { return Ok(None) };
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

/// Figures of all names of a run, in the order of tables.
pub(super) async fn figures(readers: &Readers, run: i64) -> Result<Vec<(Name, Figures)>, StoreError> {
    Ok(stages(readers, run).await?.into_iter().map(|known| (known.stage, known.figures)).collect())
}
