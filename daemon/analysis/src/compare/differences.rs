//! Differences of two lines, stage by stage.

use std::num::NonZero;
use std::panic::resume_unwind;
use std::sync::LazyLock;
use std::thread::available_parallelism;

use peernet_logger::{Name, stage};
use serde::Serialize;

use super::median_bootstrap::{PooledValues, median_difference};
use super::{Comparison, Difference, MeanEstimate, accepted_values};
use crate::loaded::Loaded;
use crate::order::mean;
use crate::rows::RowRef;

/// Stages in their order. They are in a static, so that [`STAGES`] can borrow their names.
static ORDER: [Name; stage::COUNT] = stage::ORDER;

/// Returns the names of the stages, in their order.
pub(super) fn stage_names() -> impl Iterator<Item = &'static str> {
    ORDER.iter().map(Name::as_str)
}

/// Stages, totals and further times whose differences are computed if both lines of a comparison have them.
pub static STAGES: LazyLock<Vec<&'static str>> = LazyLock::new(|| {
    let further_times = ["stages-total", "unattributed", "total", "lateness"];
    stage_names().chain(further_times).collect()
});

/// Differences between two lines of a comparison, stage by stage. Seconds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Differences {
    /// Name of the line that is the reference.
    pub baseline: String,
    /// Name of the line that is compared with the reference.
    pub other: String,
    /// Stages that both lines have.
    pub stages: Vec<StageDifference>,
}

/// Difference of two lines in one stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageDifference {
    /// Name of the stage.
    pub stage: String,
    /// Mean of the baseline and mean of the other line.
    pub means: (f64, f64),
    /// Mean of the other line minus the mean of the baseline.
    #[serde(rename = "mean")]
    pub mean_difference: Difference,
    /// Median of the baseline and median of the other line.
    pub medians: (f64, f64),
    /// Median of the other line minus the median of the baseline.
    #[serde(rename = "median")]
    pub median_difference: Difference,
    /// Further error of the difference, because the clock offset is known only within bounds. The intervals of the two
    /// differences do not include this error. It is the sum of two means: the mean half width of the clock bounds in
    /// the baseline, and the mean half width in the other line. `None` for stages that a single clock measured.
    #[serde(rename = "clocks")]
    pub clock_error: Option<f64>,
}

impl Differences {
    /// Compares two lines of a comparison of `runs`. `baseline` and `other` are indexes of lines; `seed` is the seed of
    /// the bootstrap.
    pub fn between_lines(
        comparison: &Comparison,
        runs: &[Loaded],
        baseline: usize,
        other: usize,
        seed: u64,
    ) -> Self {
        let name_and_runs = |index: usize| {
            let line = &comparison.lines[index];
            let runs: Vec<&Loaded> = line.runs.iter().map(|run| &runs[*run]).collect();
            (line.name.clone(), runs)
        };
        let (baseline, other) = (name_and_runs(baseline), name_and_runs(other));
        Self::between_groups((baseline.0, &baseline.1), (other.0, &other.1), seed)
    }

    fn between_groups(baseline: (String, &[&Loaded]), other: (String, &[&Loaded]), seed: u64) -> Self {
        let (a, b) = (baseline.1, other.1);
        // A computation holds all values of its stage in memory. Each thread therefore computes several stages one
        // after the other, so that only as many stages are in memory as there are threads.
        let stages_per_thread = STAGES.len().div_ceil(available_parallelism().map_or(1, NonZero::get));
        let differences_of = |stages: &[&str]| {
            let differences = stages.iter().filter_map(|stage| StageDifference::new(stage, a, b, seed));
            differences.collect::<Vec<_>>()
        };
        let stages = std::thread::scope(|scope| {
            let differences_of = &differences_of;
            let threads: Vec<_> = STAGES
                .chunks(stages_per_thread)
                .map(|stages| scope.spawn(move || differences_of(stages)))
                .collect();
            let differences =
                threads.into_iter().map(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic)));
            differences.flatten().collect()
        });
        Self { baseline: baseline.0, other: other.0, stages }
    }
}

impl StageDifference {
    fn new(stage: &str, baseline: &[&Loaded], other: &[&Loaded], seed: u64) -> Option<Self> {
        let values_of = |runs: &[&Loaded]| -> Vec<Vec<f64>> {
            runs.iter().map(|run| accepted_values(&run.rows, stage)).collect()
        };
        let (a, b) = (values_of(baseline), values_of(other));
        let means = (MeanEstimate::from_values(&a)?, MeanEstimate::from_values(&b)?);
        let pooled = (PooledValues::new(&a), PooledValues::new(&b));
        Some(Self {
            stage: stage.to_owned(),
            means: (means.0.mean(), means.1.mean()),
            mean_difference: Difference::between_means(&means.0, &means.1),
            medians: (pooled.0.median()?, pooled.1.median()?),
            median_difference: median_difference(&pooled.0, &pooled.1, seed)?,
            clock_error: mean_clock_half_width(baseline, stage)
                .zip(mean_clock_half_width(other, stage))
                .map(|(a, b)| a + b),
        })
    }
}

/// Returns half the mean width of a delay's clock bounds, seconds. `None` for stages that are not delays, and if no
/// delay has bounds.
fn mean_clock_half_width(runs: &[&Loaded], stage: &str) -> Option<f64> {
    stage::is_one_way(stage).then_some(())?;
    let width =
        |row: RowRef<'_>| Some(row.value(&format!("{stage}-hi"))? - row.value(&format!("{stage}-lo"))?);
    let rows = runs.iter().flat_map(|run| &run.rows).filter(|row| row.is_in_statistics());
    mean(rows.filter_map(width)).map(|width| width / 2.0)
}
