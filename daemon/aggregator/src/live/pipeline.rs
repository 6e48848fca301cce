//! What is known of one pipeline, now.

use std::collections::BTreeMap;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use peernet_logger::{HostId, RunId, Slug};
use peernet_statistics::{Merge, Windows};
use peernet_stream::{PipelineLive, PipelineState, Placement};

use super::bounds;
use super::cell::Cell;
use super::percentiles::Percentiles;
use crate::picture::{LiveSecond, PipelinePicture, Window};

/// The windows of the picture, in complete seconds.
const WINDOWS: [u32; 3] = [1, 10, 60];
/// Seconds taken in with their sketches: the longest window and the second under way.
const SKETCHES_S: i64 = 61;
/// Room in their ring: for a clock that is set back by less than a [`STEP`].
const RING_S: usize = 64;
/// Seconds kept as points of the live charts.
const SERIES_S: i64 = 600;
/// A clock that goes back by more was set.
const STEP: Span = Span::from_seconds(2);
/// Updates come four times a second: after this long without one, time goes on without the agent.
const SILENT: Span = Span::from_seconds(1);

/// One pipeline: rings of the last seconds on the agent's own wall clock, whatever that shows.
#[derive(Debug)]
pub(super) struct Pipeline {
    state: PipelineState,
    run: Option<RunId>,
    placement: Placement,
    load: String,
    recent: Windows<Cell>,
    series: BTreeMap<i64, Arc<LiveSecond>>,
    percentiles: Percentiles,
    /// The agent's clock at the last update.
    sent: WallTime,
    /// Our clocks at the last update.
    seen: Stamp,
    /// As last drawn; `None` when something changed since.
    picture: Option<Arc<PipelinePicture>>,
}

impl Pipeline {
    /// A pipeline at its first update.
    pub(super) fn new(live: PipelineLive, sent: WallTime, now: Stamp, left_out: &mut u64) -> Self {
        let mut pipeline = Self {
            state: PipelineState::Starting,
            run: None,
            placement: live.placement.clone(),
            load: String::new(),
            recent: Windows::new(RING_S),
            series: BTreeMap::new(),
            percentiles: Percentiles::default(),
            sent,
            seen: now,
            picture: None,
        };
        pipeline.update(live, sent, now, left_out);
        pipeline
    }

    /// Takes over an update. A second that was known is replaced: each report of it is complete up to then.
    pub(super) fn update(&mut self, mut live: PipelineLive, sent: WallTime, now: Stamp, left_out: &mut u64) {
        bounds::state(&mut live.state);
        bounds::placement(&mut live.placement);
        bounds::text(&mut live.load);
        if self.sent - sent > STEP {
            // The clock was set back and shows these seconds again: what is known of them happened at other times.
            self.recent.forget_from(sent.unix_seconds());
            drop(self.series.split_off(&sent.unix_seconds()));
            self.percentiles.forget_from(sent.unix_seconds());
        }
        (self.sent, self.seen) = (sent, now);
        (self.state, self.run, self.placement, self.load) = (live.state, live.run, live.placement, live.load);
        let newest = sent.unix_seconds();
        for second in live.seconds {
            let at = second.at;
            // A clock that was set, or a hostile agent: such a second would push all others out of the rings.
            if at > newest || at <= newest.saturating_sub(SERIES_S) {
                *left_out += 1;
                continue;
            }
            let cell = Cell::of(second, left_out);
            self.series.insert(at, Arc::new(cell.draw(at)));
            self.percentiles.replace(at, cell.total());
            if at > newest - SKETCHES_S {
                self.recent.replace(at, cell);
            }
        }
        let oldest = newest.saturating_sub(SERIES_S) + 1;
        self.series = self.series.split_off(&oldest);
        self.percentiles.forget_before(oldest);
        self.picture = None;
    }

    /// When it was last heard of.
    pub(super) fn seen(&self) -> MonoTime {
        self.seen.mono
    }

    /// The windows must be drawn again when time goes on without updates.
    pub(super) fn age(&mut self, now: Stamp) -> bool {
        let empty =
            |picture: &Arc<PipelinePicture>| picture.windows.iter().all(|window| window.counts.total() == 0);
        let ageing =
            now.mono - self.seen.mono > SILENT && self.picture.as_ref().is_some_and(|drawn| !empty(drawn));
        if ageing {
            self.picture = None;
        }
        ageing
    }

    /// The agent's clock at the last update.
    pub(super) fn sent(&self) -> WallTime {
        self.sent
    }

    /// Its agent stopped, and the pipeline with it.
    pub(super) fn end(&mut self) {
        if !matches!(self.state, PipelineState::Finished | PipelineState::Failed(_)) {
            self.state = PipelineState::Finished;
            self.picture = None;
        }
    }

    /// Its host is gone: what was under way may go on there or not.
    pub(super) fn away(&mut self) {
        if !matches!(self.state, PipelineState::Finished | PipelineState::Failed(_)) {
            self.state = PipelineState::Away;
            self.picture = None;
        }
    }

    /// Something beside the updates changed what is drawn.
    pub(super) fn redraw(&mut self) {
        self.picture = None;
    }

    /// The current or last run.
    pub(super) fn run(&self) -> Option<RunId> {
        self.run
    }

    /// The pipeline as it is shown; `number` knows the store's numbers of runs.
    pub(super) fn picture(
        &mut self,
        (host, host_name, pipeline): (HostId, &Slug, &Slug),
        number: impl Fn(RunId) -> Option<i64>,
        now: Stamp,
    ) -> Arc<PipelinePicture> {
        if let Some(drawn) = &self.picture {
            return Arc::clone(drawn);
        }
        let picture = Arc::new(PipelinePicture {
            host,
            host_name: host_name.clone(),
            pipeline: pipeline.clone(),
            state: self.state.clone(),
            run: self.run,
            run_number: self.run.and_then(number),
            placement: self.placement.clone(),
            load: self.load.clone(),
            last_seen: self.seen.wall,
            windows: self.windows(now),
            series: self.series.values().cloned().collect(),
            total_p95: self.percentiles.series(),
        });
        self.picture = Some(Arc::clone(&picture));
        picture
    }

    /// The windows end at the agent's last update, or later when it has been silent for long.
    fn windows(&self, now: Stamp) -> [Window; 3] {
        let silence = now.mono - self.seen.mono;
        let end = if silence > SILENT { self.sent + silence } else { self.sent };
        let current = end.unix_seconds();
        let under_way = (end - WallTime::from_unix_nanos(current.saturating_mul(1_000_000_000))).seconds();
        // A pipeline that began within the window has no rate before; a moment after its begin has none yet.
        let known_for = self
            .series
            .first_key_value()
            .map_or(f64::INFINITY, |(first, _)| ((current - first) as f64 + under_way).max(1.0));
        let mut sum = Cell::default();
        let mut merged = 0;
        // Each window holds the shorter one, and all hold the second under way.
        WINDOWS.map(|seconds| {
            let cells = i64::from(seconds) + 1;
            for (_, cell) in self.recent.iter(current - merged, (cells - merged) as usize) {
                sum.merge(cell);
            }
            merged = cells;
            sum.window(seconds, (f64::from(seconds) + under_way).min(known_for))
        })
    }
}
