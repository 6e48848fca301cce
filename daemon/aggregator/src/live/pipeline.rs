//! The current state of one pipeline.

use std::collections::BTreeMap;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::{HostId, RunId, Slug};
use peernet_statistics::{Merge, RecentSeconds};
use peernet_stream::{PipelineLive, PipelineState, Placement};

use super::limits;
use super::percentiles::Percentiles;
use super::second_statistics::SecondStatistics;
use crate::live_state::{LiveSecond, PipelineSnapshot, Window};

/// Lengths of the live state's windows, in complete seconds.
const WINDOWS: [u32; 3] = [1, 10, 60];
/// Number of seconds that are kept with their sketches: the longest window and the incomplete second.
const SKETCH_LENGTH_S: i64 = 61;
/// Length of the ring of the seconds with sketches. Two of the three seconds beyond [`SKETCH_LENGTH_S`] are for an
/// agent's clock that decreases by at most [`MAX_CLOCK_DECREASE`]; the third is a reserve.
const RING_LENGTH_S: usize = 64;
/// Number of seconds that are kept as points of the live charts.
const CHART_LENGTH_S: i64 = 600;
/// Largest decrease of the agent's clock between two updates that the ring absorbs. After a larger decrease, the
/// seconds that the clock shows again are removed.
const MAX_CLOCK_DECREASE: Span = Span::from_seconds(2);
/// Silence of the agent after which the windows end at the present, not at the latest update. Updates arrive four
/// times a second.
const MAX_UPDATE_AGE: Span = Span::from_seconds(1);

/// State of one pipeline, with rings of the last seconds by the agent's wall clock, which may be wrong.
#[derive(Debug)]
pub(super) struct Pipeline {
    state: PipelineState,
    run: Option<RunId>,
    placement: Placement,
    load: String,
    recent: RecentSeconds<SecondStatistics>,
    series: BTreeMap<i64, Arc<LiveSecond>>,
    percentiles: Percentiles,
    /// The agent's clock at the latest update.
    sent: WallTime,
    /// The aggregator's clocks at the latest update.
    last_seen: Stamp,
    /// The latest snapshot; `None` if something changed since.
    snapshot: Option<Arc<PipelineSnapshot>>,
}

impl Pipeline {
    /// Creates the state at the pipeline's first update. Adds to `discarded_items` the number of seconds and
    /// names that were discarded.
    pub(super) fn new(live: PipelineLive, sent: WallTime, now: Stamp, discarded_items: &mut u64) -> Self {
        let mut pipeline = Self {
            state: PipelineState::Starting,
            run: None,
            placement: live.placement.clone(),
            load: String::new(),
            recent: RecentSeconds::new(RING_LENGTH_S),
            series: BTreeMap::new(),
            percentiles: Percentiles::default(),
            sent,
            last_seen: now,
            snapshot: None,
        };
        pipeline.update(live, sent, now, discarded_items);
        pipeline
    }

    /// Applies an update. The report of a second replaces an earlier report of the same second, because each report of
    /// a second covers the second from its start. Adds to `discarded_items` the number of seconds and names that were
    /// discarded.
    pub(super) fn update(
        &mut self,
        mut live: PipelineLive,
        sent: WallTime,
        now: Stamp,
        discarded_items: &mut u64,
    ) {
        limits::limit_state(&mut live.state);
        limits::limit_placement(&mut live.placement);
        limits::limit_text(&mut live.load);
        if self.sent - sent > MAX_CLOCK_DECREASE {
            // The clock was set back and repeats these seconds; the seconds in the rings happened at other times.
            self.recent.remove_from(sent.unix_seconds());
            drop(self.series.split_off(&sent.unix_seconds()));
            self.percentiles.remove_from(sent.unix_seconds());
        }
        (self.sent, self.last_seen) = (sent, now);
        (self.state, self.run, self.placement, self.load) = (live.state, live.run, live.placement, live.load);
        let newest = sent.unix_seconds();
        for second in live.seconds {
            let at = second.at;
            // Seconds outside the charts are reported after a step of the clock or by a hostile agent. A much later
            // second would displace all other seconds from the rings.
            if at > newest || at <= newest.saturating_sub(CHART_LENGTH_S) {
                *discarded_items += 1;
                continue;
            }
            let second_statistics = SecondStatistics::from_report(second, discarded_items);
            self.series.insert(at, Arc::new(second_statistics.to_live_second(at)));
            self.percentiles.replace(at, second_statistics.total());
            // Sketches are large; older seconds are kept as points of the charts only.
            if at > newest - SKETCH_LENGTH_S {
                self.recent.replace(at, second_statistics);
            }
        }
        let oldest = newest.saturating_sub(CHART_LENGTH_S) + 1;
        self.series = self.series.split_off(&oldest);
        self.percentiles.forget_before(oldest);
        self.snapshot = None;
    }

    /// Returns the time of the latest update.
    pub(super) fn last_seen(&self) -> MonoTime {
        self.last_seen.mono
    }

    /// Discards the snapshot if the agent is silent and a window has iterations: the windows then end at the present,
    /// so their values change with time. Returns whether the snapshot was discarded.
    pub(super) fn expire(&mut self, now: Stamp) -> bool {
        let is_empty = |snapshot: &Arc<PipelineSnapshot>| {
            snapshot.windows.iter().all(|window| window.counts.total() == 0)
        };
        let is_outdated = now.mono - self.last_seen.mono > MAX_UPDATE_AGE
            && self.snapshot.as_ref().is_some_and(|cached| !is_empty(cached));
        if is_outdated {
            self.snapshot = None;
        }
        is_outdated
    }

    /// Returns the agent's clock at the latest update.
    pub(super) fn sent(&self) -> WallTime {
        self.sent
    }

    /// Marks the pipeline as finished, because its agent stopped cleanly.
    pub(super) fn mark_finished(&mut self) {
        if !matches!(self.state, PipelineState::Finished | PipelineState::Failed(_)) {
            self.state = PipelineState::Finished;
            self.snapshot = None;
        }
    }

    /// Marks the pipeline as away, because its host became silent. Whether the host still runs the pipeline is unknown.
    pub(super) fn mark_away(&mut self) {
        if !matches!(self.state, PipelineState::Finished | PipelineState::Failed(_)) {
            self.state = PipelineState::Away;
            self.snapshot = None;
        }
    }

    /// Discards the snapshot after a change outside the updates.
    pub(super) fn invalidate_snapshot(&mut self) {
        self.snapshot = None;
    }

    /// Returns the current or last run.
    pub(super) fn run(&self) -> Option<RunId> {
        self.run
    }

    /// Returns the pipeline's snapshot. `number` returns the store's number of a run.
    pub(super) fn snapshot(
        &mut self,
        (host, host_name, pipeline): (HostId, &Slug, &Slug),
        number: impl Fn(RunId) -> Option<i64>,
        now: Stamp,
    ) -> Arc<PipelineSnapshot> {
        // Unchanged pipelines share one snapshot between snapshots of the live state.
        if let Some(cached) = &self.snapshot {
            return Arc::clone(cached);
        }
        let snapshot = Arc::new(PipelineSnapshot {
            host,
            host_name: host_name.clone(),
            pipeline: pipeline.clone(),
            state: self.state.clone(),
            run: self.run,
            run_number: self.run.and_then(number),
            placement: self.placement.clone(),
            load: self.load.clone(),
            last_seen: self.last_seen.wall,
            windows: self.windows(now),
            series: self.series.values().cloned().collect(),
            total_p95: self.percentiles.series(),
        });
        self.snapshot = Some(Arc::clone(&snapshot));
        snapshot
    }

    /// Returns the windows. The windows end at the agent's latest update, or at the present if the agent is silent.
    fn windows(&self, now: Stamp) -> [Window; 3] {
        let silence = now.mono - self.last_seen.mono;
        let end = if silence > MAX_UPDATE_AGE { self.sent + silence } else { self.sent };
        let current = end.unix_seconds();
        // Elapsed part of the incomplete second.
        let elapsed_s = (end - WallTime::from_unix_nanos(current.saturating_mul(1_000_000_000))).seconds();
        // The time before the pipeline's start does not lower the rate. At least 1 s is assumed, so that a pipeline
        // that has just started has no extreme rate.
        let running_s = self
            .series
            .first_key_value()
            .map_or(f64::INFINITY, |(first, _)| ((current - first) as f64 + elapsed_s).max(1.0));
        let mut sum = SecondStatistics::default();
        // Number of seconds in `sum`, counted backwards from the incomplete second.
        let mut merged_s = 0;
        // Each window contains the shorter windows, and all contain the incomplete second.
        WINDOWS.map(|seconds| {
            let length = i64::from(seconds) + 1;
            for (_, second_statistics) in self.recent.iter(current - merged_s, (length - merged_s) as usize) {
                sum.merge(second_statistics);
            }
            merged_s = length;
            sum.window(seconds, (f64::from(seconds) + elapsed_s).min(running_s))
        })
    }
}
