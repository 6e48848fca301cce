//! Reads the values from which the trust findings of a run are computed: its stored statistics.

use peernet_analysis::accuracy::{ACCURACIES, Accuracy, UNKNOWN_LABEL, UnknownLabels};
use peernet_analysis::rows::LATENESS;
use peernet_analysis::trust::{
    Clocks, Counts, EndedEarly, Limits, Load, MissingEvents, OVERRUN, Progress, Restarts, Starts, TimeSeries,
    TrustInput,
};
use peernet_logger::stage;
use peernet_stream::EndReason;
use serde::Deserialize;

use super::statistics::{stage_buckets, statistics};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::{RunDetail, RunStatistics, RunSummary, StageBuckets};

/// Largest number of buckets in which a run's time series is read.
const BUCKETS: usize = 120;

pub(crate) async fn trust_input(readers: &Readers, run: &RunDetail) -> Result<TrustInput, StoreError> {
    let number = run.summary.number;
    let numbers = [number];
    let (run_statistics, stages_over_time) =
        tokio::try_join!(statistics(readers, &numbers), stages_over_time(readers, number))?;
    Ok(collect(run, &run_statistics.into_iter().next().unwrap_or_default(), &stages_over_time))
}

/// Reads the time series of the total latency. If the run has no totals, because it only reads a sensor, reads the time series of
/// sensing instead.
///
/// The stages are read only if the total changed notably during the run, because over a day the stages have tens of thousands of rows.
async fn stages_over_time(readers: &Readers, run: i64) -> Result<Vec<StageBuckets>, StoreError> {
    let mut stages = stage_buckets(readers, run, &[stage::TOTAL], BUCKETS).await?;
    let has_notable_change = |stage: &StageBuckets| {
        TimeSeries::from_summaries(&stage.buckets).is_some_and(|series| series.has_notable_change())
    };
    if stages.is_empty() {
        stages = stage_buckets(readers, run, &[stage::SENSING], BUCKETS).await?;
    } else if stages.iter().any(has_notable_change) {
        stages.extend(stage_buckets(readers, run, &stage::ORDER, BUCKETS).await?);
    }
    Ok(stages)
}

/// Collects the values from which the trust findings of a run are computed. `stages_over_time` is the result of the function of that
/// name.
fn collect(run: &RunDetail, run_statistics: &RunStatistics, stages_over_time: &[StageBuckets]) -> TrustInput {
    let RunStatistics { stages: statistics, bounds, .. } = run_statistics;
    let counts = Counts {
        ok: run.summary.counts.ok,
        failed: run.summary.counts.failed,
        lost: run.summary.counts.lost,
        timeout: run.summary.counts.timeout,
        warm_up: run.summary.warm_up,
    };
    let figures =
        |name: &str| statistics.iter().find(|stage| stage.stage == *name).map(|stage| stage.figures);
    let mut stages: Vec<(String, TimeSeries)> = stages_over_time
        .iter()
        .filter_map(|stage| Some((stage.stage.to_string(), TimeSeries::from_summaries(&stage.buckets)?)))
        .collect();
    let total =
        stages.iter().position(|(name, _)| name == stage::TOTAL.as_str()).map(|index| stages.remove(index).1);
    let sensing =
        || stages.iter().find(|(name, _)| name == stage::SENSING.as_str()).map(|(_, series)| series.clone());
    // An agent of another version may write the configuration in another form. The report then contains no limit and no rate.
    let configured: Option<Configured> = toml::from_str(&run.configuration).ok();
    let input = TrustInput {
        conditions: run.conditions.clone(),
        counts,
        open: run.summary.ended.is_none(),
        ended_early: configured.and_then(|configured| ended_early(run, &counts, configured.limit)),
        starts: Starts {
            hz: configured.and_then(|configured| configured.load.hz),
            actual_hz: actual_hz(run, &counts),
            ..Starts::from(&run.summary)
        },
        missing: run
            .gaps
            .iter()
            .map(|gap| MissingEvents { count: gap.count, reason: gap.reason.clone() })
            .collect(),
        total: total.or_else(sensing),
        unattributed: figures(&stage::UNATTRIBUTED).map(|figures| figures.mean),
        lateness: figures(LATENESS).map(|figures| figures.mean),
        overrun: figures(OVERRUN).map(|figures| figures.mean),
        restarts: Restarts::NODES
            .into_iter()
            .filter_map(|(owner, name, _)| {
                let figures = figures(&name)?;
                let seconds = figures.mean * figures.count as f64;
                Some(Restarts { owner, count: figures.count, seconds, iterations: Vec::new() })
            })
            .collect(),
        clocks: bounds
            .iter()
            .map(|bound| Clocks {
                stage: bound.stage.to_string(),
                verdicts: bound.verdicts.clone(),
                delay: figures(&bound.stage).map(|figures| figures.p50),
                half_width: bound.half_width.map(|width| width.p50),
            })
            .collect(),
        stages,
        accuracy: ACCURACIES
            .into_iter()
            .filter_map(|name| {
                let scores = figures(name)?;
                Some((name.to_owned(), Accuracy::from_mean(scores.mean, scores.count, counts.ok)?))
            })
            .collect(),
        unknown_labels: figures(UNKNOWN_LABEL)
            .and_then(|figures| UnknownLabels::new(figures.count, &run.facts)),
        ..TrustInput::default()
    };
    input.with_end_reason(run.summary.reason.as_ref()).with_facts(&run.facts)
}

/// Part of a run's configuration that a report needs.
#[derive(Clone, Copy, Deserialize)]
struct Configured {
    #[serde(default)]
    limit: Limits,
    #[serde(default)]
    load: Load,
}

/// Leaves out the rates, which a summary does not contain.
impl From<&RunSummary> for Starts {
    fn from(run: &RunSummary) -> Self {
        Self { started: run.counts.total(), skipped: run.skipped_starts, ..Self::default() }
    }
}

/// Returns the starts per second over the whole run. The warm-up is included, because the store does not keep when it ended.
fn actual_hz(run: &RunDetail, counts: &Counts) -> Option<f64> {
    let seconds = (run.summary.last_iteration? - run.summary.started).seconds();
    // Missing iterations were started, too, so the rate of an incomplete run is unknown.
    let is_complete = run.gaps.is_empty() && seconds > 0.0;
    is_complete.then(|| (counts.measured() + counts.warm_up) as f64 / seconds)
}

/// Compares a run that has ended with the limits in its configuration.
fn ended_early(run: &RunDetail, counts: &Counts, limit: Limits) -> Option<EndedEarly> {
    let summary = &run.summary;
    summary.ended?;
    // If the number of missing events is unknown, the progress of the run is unknown, too.
    let missing_events =
        run.gaps.iter().map(|gap| (gap.count > 0).then_some(gap.count)).sum::<Option<u64>>()?;
    let progress = Progress {
        measured: counts.measured() + missing_events,
        warm_up: counts.warm_up,
        // Includes the warm-up, because the store does not keep when it ended.
        seconds: summary.last_iteration.map_or(0.0, |last| (last - summary.started).seconds()),
    };
    EndedEarly::from_progress(&limit, &progress, summary.reason.as_ref().unwrap_or(&EndReason::Unknown))
}

#[cfg(test)]
mod tests;
