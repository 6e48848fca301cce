//! Taking down what the agent measures, until it ends.

use std::convert::Infallible;

use peernet_agent::config::{Limit, PipelineConfig, PlacementConfig};
use peernet_agent::{Cloud, Running};
use peernet_analysis::rows::{Outcome, Row, Rows, Units};
use peernet_clock::{MonoTime, SharedClock, Span, WallTime};
use peernet_logger::Slug;
use peernet_networks::OpenError;
use peernet_results::RowWriter;
use peernet_statistics::Summary;
use peernet_stream::{Event, HostClock, HostDescription, IncidentKind, PipelineState, RunDescription};

use super::{Phase, Seen, Watcher};
use crate::foreground::{Ended, PeerWait, PipelineActivity, RunObserver, p99};

/// Observer of the agent.
pub(super) struct Taking<'a> {
    clock: SharedClock,
    watcher: &'a mut dyn Watcher,
    peer_wait: PeerWait,
    most: Span,
    progress: RunProgress,
    pipeline: Slug,
    /// The peer's address, then its name; `None` for a run on board.
    peer: Option<String>,
    /// Why the peer did not want at the first try.
    refused: bool,
    taken: Taken,
    writer: RowWriter,
}

/// How far a run is, by its limit.
struct RunProgress {
    limit: Limit,
    /// Warm-up iterations at the least.
    warm_up: u64,
    began: Option<MonoTime>,
    /// Iterations that ended.
    done: u64,
    /// Totals of those that count, seconds.
    totals: Summary,
}

impl RunProgress {
    fn new(limit: Limit, warm_up: u64) -> Self {
        Self { limit, warm_up, began: None, done: 0, totals: Summary::default() }
    }

    fn add(&mut self, row: &Row) {
        self.done += 1;
        if let Some(total) = row.value("total").or(row.value("sensing")).filter(|_| row.counts()) {
            self.totals.record(total);
        }
    }

    /// Returns the number of iterations that there will be, where it sets the end.
    fn iterations(&self) -> Option<u64> {
        let counted = self.limit.iterations.map(|limit| limit.get().saturating_add(self.warm_up));
        let total = self.limit.total.map(std::num::NonZero::get);
        counted.into_iter().chain(total).min()
    }

    fn is_complete(&self) -> bool {
        self.limit.total.is_some_and(|total| self.done >= total.get())
    }

    /// Returns what is shown of it in this phase.
    fn show(&self, phase: Phase, trouble: Option<String>, now: MonoTime) -> Seen {
        let (done, of) = (self.done, self.iterations());
        let elapsed = self.began.map_or(0.0, |began| (now - began).seconds());
        let rate = if elapsed > 0.0 { done as f64 / elapsed } else { 0.0 };
        let by_count = of.filter(|_| rate > 0.0).map(|of| of.saturating_sub(done) as f64 / rate);
        let by_time = self.limit.duration_s.filter(|_| self.began.is_some());
        let by_time = by_time.map(|seconds| (seconds - elapsed).max(0.0));
        Seen {
            phase,
            done,
            of,
            rate,
            p50: self.totals.quantile(0.5),
            p99: p99(&self.totals),
            left_s: by_count.into_iter().chain(by_time).reduce(f64::min),
            trouble,
        }
    }
}

/// What was seen.
#[derive(Default)]
pub(super) struct Taken {
    pub(super) rows: Rows,
    /// Of the columns that the run logs itself.
    pub(super) units: Units,
    /// What was told when the run began.
    pub(super) description: Option<RunDescription>,
    /// When it ended, by the edge's wall clock.
    pub(super) ended: Option<WallTime>,
    /// Who sensed.
    pub(super) edge: Option<HostDescription>,
    /// Who served.
    pub(super) cloud: Option<Cloud>,
    /// What disciplines the edge's clock, in words.
    pub(super) edge_clock: Option<String>,
    /// The same of the cloud's.
    pub(super) cloud_clock: Option<String>,
    /// Rows that are not in the file, and why.
    pub(super) unwritten: Option<String>,
}

impl<'a> Taking<'a> {
    pub(super) fn new(
        pipeline: &PipelineConfig,
        most: Span,
        writer: RowWriter,
        clock: SharedClock,
        watcher: &'a mut dyn Watcher,
    ) -> Self {
        let peer = match &pipeline.placement {
            PlacementConfig::Remote(remote) => Some(remote.peer.to_string()),
            PlacementConfig::Local { .. } | PlacementConfig::None {} | PlacementConfig::Observe(_) => None,
        };
        Self {
            peer_wait: PeerWait::new(clock.mono()),
            clock,
            watcher,
            most,
            progress: RunProgress::new(pipeline.limit, pipeline.warm_up.iterations),
            pipeline: pipeline.name.clone(),
            peer,
            refused: false,
            taken: Taken::default(),
            writer,
        }
    }

    /// What was seen, all of it in the file where there was room.
    pub(super) fn finish(self) -> Taken {
        let mut taken = self.taken;
        taken.unwritten = self.writer.end().err().map(|error| error.to_string());
        taken
    }

    fn began(&mut self, run: RunDescription) {
        let now = self.clock.mono();
        self.peer_wait.record_answer(now);
        self.progress.began.get_or_insert(now);
        self.watcher.begun(&run.conditions);
        if let (Some(peer), Some(name)) = (&mut self.peer, &run.placement.peer) {
            *peer = name.to_string();
        }
        self.taken.description = Some(run);
    }

    /// Who serves may be another program after it was away.
    fn meet(&mut self, running: Option<&Running>) {
        let cloud = running.and_then(|running| running.served_by(&self.pipeline));
        self.taken.cloud = cloud.or(self.taken.cloud.take());
        let Some(live) = running.map(Running::live) else { return };
        let words = |clock: HostClock| Some(clock.text).filter(|text| !text.is_empty());
        let peer = self.taken.cloud.as_ref().map(|cloud| cloud.id);
        let link = live.links.into_iter().find(|link| Some(link.peer) == peer);
        self.taken.edge_clock = words(live.clock).or(self.taken.edge_clock.take());
        self.taken.cloud_clock =
            link.and_then(|link| link.cloud).and_then(words).or(self.taken.cloud_clock.take());
    }

    fn row(&mut self, row: &Row) {
        // A failure is an answer, too.
        if matches!(row.outcome, Outcome::Ok | Outcome::Failed) {
            self.peer_wait.record_answer(self.clock.mono());
        }
        self.progress.add(row);
        self.writer.write(row);
        self.taken.rows.push(row);
    }

    fn seen(&self, trouble: Option<String>) -> Seen {
        let phase = match (&trouble, self.progress.began, self.taken.rows.last()) {
            (_, None, _) => Phase::Starting,
            (Some(_), ..) => Phase::Waiting,
            (None, _, last) if last.is_none_or(|row| row.warm_up()) => Phase::WarmUp,
            _ => Phase::Measuring,
        };
        self.progress.show(phase, trouble, self.clock.mono())
    }
}

impl RunObserver for Taking<'_> {
    type Own = Infallible;

    fn take(&mut self, event: Event, running: Option<&Running>) -> Option<Ended> {
        match event {
            Event::RunStarted(run) => {
                self.began(run);
                self.taken.edge = running.map(Running::description).or(self.taken.edge.take());
                self.meet(running);
            }
            Event::Iteration(iteration) => {
                let row = self.taken.units.row(&iteration);
                self.row(&row);
            }
            Event::RunEnded(run) => {
                self.taken.ended = Some(run.ended);
                // A time daemon may have been heard only since the run began.
                self.meet(running);
                return Some(Ended::of_run(run.reason, "run"));
            }
            Event::Incident(incident) => match incident.kind {
                // Later ones are told by the end of the run, or passed over.
                IncidentKind::PipelineFailed if self.taken.description.is_none() => {
                    return Some(Ended::Failed(incident.text));
                }
                IncidentKind::Refused if self.taken.description.is_none() => self.refused = true,
                IncidentKind::Connected => {
                    self.meet(running);
                    if running.is_some() {
                        self.peer_wait.record_answer(self.clock.mono());
                    }
                }
                _ => {}
            },
            Event::Clock(_) | Event::Gap(_) => {}
        }
        None
    }

    fn look(&mut self, running: &Running) -> Option<Ended> {
        self.writer.flush();
        // The peer may leave with the last answer: there is nothing to come back for.
        if self.progress.is_complete() {
            return Some(Ended::Finished);
        }
        let pipelines = running.live().pipelines;
        // Its last events are on their way by then, if there was room for them.
        match pipelines.into_iter().next().map(|one| one.state) {
            Some(PipelineState::Failed(reason)) => return Some(Ended::Failed(reason)),
            Some(PipelineState::Finished) => return Some(Ended::Finished),
            _ => {}
        }
        let activity = PipelineActivity::of(running);
        let reason = activity.waits_for();
        if let (true, Some(reason)) = (self.refused, reason) {
            return Some(Ended::Failed(reason.to_owned()));
        }
        // There is no configuration here to change.
        let reason = reason.map(|reason| reason.strip_suffix(OpenError::LOADING).unwrap_or(reason));
        let full = self.writer.trouble().map(|trouble| format!("{trouble}; the rows are kept in memory"));
        let now = self.clock.mono();
        let slow = activity.slow_sensor(now);
        let Some(peer) = &self.peer else {
            let seen = self.seen(slow.or(full));
            self.watcher.look(&seen);
            return None;
        };
        self.peer_wait.update(&activity, now);
        let trouble = match (&self.progress.began, reason) {
            (None, None) => None,
            _ => self.peer_wait.describe_trouble(peer, reason, now, self.most),
        };
        let spent = self.peer_wait.reason_to_give_up(reason, now, self.most);
        let seen = self.seen(slow.or(trouble).or(full));
        self.watcher.look(&seen);
        spent.map(Ended::Failed)
    }

    fn over(&mut self) {
        let seen = Seen { phase: Phase::Writing, ..self.seen(None) };
        self.watcher.look(&seen);
    }
}
