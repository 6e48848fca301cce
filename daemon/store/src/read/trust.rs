//! Reads the stored values from which the trust findings of a run are computed.

use peernet_analysis::accuracy::{ACCURACIES, Accuracy, UnknownLabels};
use peernet_analysis::outcomes::Counts;
use peernet_analysis::stage_split::StageSplit;
use peernet_analysis::standstill::{RunExtent, standstill};
use peernet_analysis::total_column::TotalColumn;
use peernet_analysis::trust::{
    DelayQuality, EndedEarly, Limits, Load, MissingEvents, Progress, Restarts, StartTimes, Starts,
    TimeSeries, TrustInput, names_of_distributions,
};
use peernet_logger::stage;
use peernet_statistics::TwoModes;
use peernet_stream::EndReason;
use serde::Deserialize;

use super::episodes::{earlier_episodes, failed_starts, first_measured_start, last_measured_start};
use super::statistics::{stage_buckets, statistics, whole_runs};
use crate::error::StoreError;
use crate::quantity_statistics::DelayAccuracy;
use crate::readers::Readers;
use crate::types::{RunDetail, RunStatistics, RunSummary, StageBuckets};

/// Maximum number of buckets of a run's time series.
const MAX_BUCKETS: usize = 120;

pub(crate) async fn trust_input(readers: &Readers, run: &RunDetail) -> Result<TrustInput, StoreError> {
    let number = run.summary.number;
    let numbers = [number];
    let (run_statistics, stages_over_time, first, last, episodes) = tokio::try_join!(
        statistics(readers, &numbers),
        stages_over_time(readers, number),
        first_measured_start(readers, number),
        last_measured_start(readers, number),
        earlier_episodes(readers, number)
    )?;
    let standstill_s = standstill_length(readers, run, stages_over_time.first()).await?;
    let run_statistics = run_statistics.into_iter().next().unwrap_or_default();
    let times = StartTimes { first, last, standstill_s };
    let input = collect_input(run, times, episodes, &run_statistics, &stages_over_time);
    Ok(TrustInput { two_modes: two_modes(readers, number, &run_statistics).await?, ..input })
}

/// Returns the length of a run's standstill, seconds. `buckets` are the buckets of the total latency, or of sensing if
/// the run has no total. `None` if there was no standstill, or if events of the run are missing: a gap in the buckets
/// may then be a gap of events.
async fn standstill_length(
    readers: &Readers,
    run: &RunDetail,
    buckets: Option<&StageBuckets>,
) -> Result<Option<f64>, StoreError> {
    let summary = &run.summary;
    let Some((buckets, end)) = buckets.zip(summary.end_time()) else {
        return Ok(None);
    };
    if !run.gaps.is_empty() {
        return Ok(None);
    }
    let extent = RunExtent {
        started: summary.started,
        end,
        iterations: summary.counts.total(),
        slowest_s: summary.total.as_ref().map_or(0.0, |total| total.max),
    };
    // Iterations of the warm-up are in no bucket. `standstill` does not count the time before the first bucket.
    let answered = || buckets.bucket_starts.iter().map(|start| (*start, *start + buckets.bucket_width));
    if standstill(&extent, answered()).is_none() {
        return Ok(None);
    }
    // Failed iterations are in no bucket, either. They are read only if a standstill is possible, because most runs
    // have none.
    let failed = failed_starts(readers, summary.number).await?;
    Ok(standstill(&extent, answered().chain(failed.into_iter().map(|start| (start, start)))))
}

/// Returns the distributions of a run that have two modes.
async fn two_modes(
    readers: &Readers,
    run: i64,
    statistics: &RunStatistics,
) -> Result<Vec<(String, TwoModes)>, StoreError> {
    let mut found = Vec::new();
    for name in names_of_distributions(statistics.stages.iter().map(|stage| stage.stage.as_str())) {
        let summary = whole_runs(readers, &[run], name).await?.remove(&run);
        found.extend(summary.and_then(|named| Some((name.to_owned(), named.summary.two_modes()?))));
    }
    Ok(found)
}

/// Reads the time series of the total latency and, if the total changed notably during the run, the time series of all
/// stages. The stages are read only in this case, because for a run of a day they have tens of thousands of rows.
///
/// If the run has no total, the function reads the time series of sensing.
async fn stages_over_time(readers: &Readers, run: i64) -> Result<Vec<StageBuckets>, StoreError> {
    let [total, sensing] = TotalColumn::Measured.latency_names();
    let mut stages = stage_buckets(readers, run, &[total], MAX_BUCKETS).await?;
    let has_notable_change = |stage: &StageBuckets| {
        TimeSeries::from_summaries(&stage.buckets).is_some_and(|series| series.has_notable_change())
    };
    if stages.is_empty() {
        stages = stage_buckets(readers, run, &[sensing], MAX_BUCKETS).await?;
    } else if stages.iter().any(has_notable_change) {
        stages.extend(stage_buckets(readers, run, &stage::ORDER, MAX_BUCKETS).await?);
    }
    Ok(stages)
}

/// Collects the values from which the trust findings of a run are computed. `stages_over_time` is the result of
/// [`stages_over_time()`], `episodes` that of [`earlier_episodes()`].
fn collect_input(
    run: &RunDetail,
    times: StartTimes,
    episodes: Option<u64>,
    run_statistics: &RunStatistics,
    stages_over_time: &[StageBuckets],
) -> TrustInput {
    // `None` if a gap has an unknown number of events. Then the progress of the run is unknown, too.
    let missing_events: Option<u64> = run.gaps.iter().map(|gap| (gap.count > 0).then_some(gap.count)).sum();
    let RunStatistics { stages: statistics, bounds, .. } = run_statistics;
    let counts = Counts {
        ok: run.summary.counts.ok,
        failed: run.summary.counts.failed,
        lost: run.summary.counts.lost,
        timeout: run.summary.counts.timeout,
        warm_up: run.summary.warm_up,
        // Events that did not reach the store are counted in `missing_events`.
        unseen: 0,
    };
    let statistics_of =
        |name: &str| statistics.iter().find(|stage| stage.stage == *name).map(|stage| stage.statistics);
    let sent_counts = DelayAccuracy::sent_messages(bounds);
    let stages = stages_over_time.iter().filter(|stage| stage.stage != stage::TOTAL);
    // An agent of another version may write the configuration in another form. The trust findings then do not mention
    // the run's limit and rate.
    let configured: Option<ConfiguredLimitAndLoad> = toml::from_str(&run.configuration).ok();
    let progress = missing_events.map(|missing_events| Progress {
        measured: counts.measured() + missing_events,
        warm_up: counts.warm_up,
        episodes,
        // If the first iterations were deleted, the time counts from the start of the run.
        seconds: StartTimes { first: times.first.or(Some(run.summary.started)), ..times }.seconds(),
    });
    let input = TrustInput {
        conditions: run.conditions.clone(),
        counts,
        in_progress: run.summary.ended.is_none(),
        ended_early: configured
            .and_then(|configured| ended_early(&run.summary, &configured.limit, &progress?)),
        starts: Starts {
            hz: configured.and_then(|configured| configured.load.hz),
            missing: missing_events,
            times,
            ..Starts::from(&run.summary)
        },
        missing: run
            .gaps
            .iter()
            .map(|gap| MissingEvents { count: gap.count, reason: gap.reason.clone() })
            .collect(),
        total: stages_over_time.first().and_then(|latency| TimeSeries::from_summaries(&latency.buckets)),
        split: StageSplit::new(sent_counts, |name| {
            statistics_of(name).map(|statistics| (statistics.count, statistics.mean))
        }),
        drawn: statistics_of(&stage::DRAWN_LATENCY).map(|statistics| statistics.mean),
        overrun: statistics_of(&stage::OVERRUN).map(|statistics| statistics.mean),
        superseded: run.summary.actuator.superseded,
        restarts: Restarts::NODES
            .into_iter()
            .filter_map(|(owner, name, _)| {
                let statistics = statistics_of(&name)?;
                Some(Restarts {
                    owner,
                    count: statistics.count,
                    seconds: statistics.sum(),
                    // Statistics do not contain the numbers of the iterations.
                    iterations: Vec::new(),
                })
            })
            .collect(),
        clocks: bounds
            .iter()
            .map(|bound| {
                let delay = statistics_of(&bound.stage);
                DelayQuality {
                    stage: bound.stage.to_string(),
                    verdicts: bound.verdicts.clone(),
                    delay: delay.as_ref().map(|statistics| statistics.p50),
                    interval: delay.as_ref().and_then(|statistics| bound.interval_of_median(statistics)),
                }
            })
            .collect(),
        stages: stages
            .filter_map(|stage| Some((stage.stage.to_string(), TimeSeries::from_summaries(&stage.buckets)?)))
            .collect(),
        accuracy: ACCURACIES
            .into_iter()
            .filter_map(|name| {
                let scores = statistics_of(name)?;
                Some((name.to_owned(), Accuracy::from_mean(scores.mean, scores.count, counts.ok)?))
            })
            .collect(),
        unknown_labels: statistics_of(&stage::UNKNOWN_LABEL)
            .and_then(|statistics| UnknownLabels::new(statistics.count, &run.facts)),
        ..TrustInput::default()
    };
    input.with_end_reason(run.summary.reason.as_ref()).with_facts(&run.facts)
}

/// The parts of a run's configuration that the trust findings need.
#[derive(Clone, Copy, Deserialize)]
struct ConfiguredLimitAndLoad {
    #[serde(default)]
    limit: Limits,
    #[serde(default)]
    load: Load,
}

/// Takes the numbers of starts from a run. The configured rate and the times are left out, because [`RunSummary`] does
/// not contain them.
impl From<&RunSummary> for Starts {
    fn from(run: &RunSummary) -> Self {
        Self { started: run.counts.total(), skipped: run.skipped_starts, ..Self::default() }
    }
}

/// Compares a run that has ended with the limits in its configuration. `None` if the run is still running, or reached
/// its limits.
fn ended_early(run: &RunSummary, limits: &Limits, progress: &Progress) -> Option<EndedEarly> {
    run.ended?;
    EndedEarly::from_progress(limits, progress, run.reason.as_ref().unwrap_or(&EndReason::Unknown))
}

#[cfg(test)]
mod tests;
