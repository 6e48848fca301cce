//! Recording of a run's measurements from the agent's events.

use std::convert::Infallible;

use peernet_agent::config::{Limit, PipelineConfig, PlacementConfig};
use peernet_agent::{Cloud, RunningAgent};
use peernet_analysis::outcomes::{Counts, is_failed_warm_up};
use peernet_analysis::rows::{Outcome, Row, Rows, Units};
use peernet_analysis::total_column::TotalColumn;
use peernet_analysis::trust::StartsSoFar;
use peernet_clock::{MonoTime, SharedClock, Span, WallTime};
use peernet_logger::Slug;
use peernet_results::RowWriter;
use peernet_statistics::{Summary, remaining_seconds};
use peernet_stream::{Event, HostClock, HostDescription, IncidentKind, PipelineState, RunDescription};

use super::agent_end::describe_failure;
use super::{Phase, ProgressDisplay, ProgressReport};
use crate::foreground::{AgentEnd, PeerWait, PipelineActivity, RunObserver};

/// Observer of the agent that records the run.
pub(super) struct RunRecorder<'a> {
    clock: SharedClock,
    progress_display: &'a mut dyn ProgressDisplay,
    peer_wait: PeerWait,
    peer_timeout: Span,
    progress: RunProgress,
    pipeline: Slug,
    /// Name of the peer, or its address until its name is known. `None` for a run without a peer.
    peer: Option<String>,
    /// `true` if the peer refused a session before the run began.
    is_refused: bool,
    recorded: RecordedRun,
    writer: RowWriter,
}

/// Progress of a run towards its limit.
struct RunProgress {
    limit: Limit,
    /// Number of iterations with the warm-up; `None` if only a time limits the run.
    iterations: Option<u64>,
    started_at: Option<MonoTime>,
    /// Start of the run, or end of the last iteration of the warm-up at its start.
    measuring_since: Option<MonoTime>,
    /// Numbers of finished iterations.
    counts: Counts,
    /// Starts of the iterations after the warm-up.
    starts: StartsSoFar,
    /// Number of failed iterations of the warm-up.
    failed_in_warm_up: u64,
    /// Description of the first failed iteration.
    first_failure: Option<String>,
    /// Totals of the successful iterations after the warm-up, seconds.
    totals: Summary,
}

impl RunProgress {
    fn new(limit: Limit, iterations: Option<u64>) -> Self {
        Self {
            limit,
            iterations,
            started_at: None,
            measuring_since: None,
            counts: Counts::default(),
            starts: StartsSoFar::default(),
            failed_in_warm_up: 0,
            first_failure: None,
            totals: Summary::default(),
        }
    }

    fn start(&mut self, now: MonoTime) {
        self.started_at.get_or_insert(now);
        self.measuring_since.get_or_insert(now);
    }

    fn add(&mut self, row: &Row, now: MonoTime) {
        self.counts.add(row.outcome, row.warm_up);
        if self.counts.measured() == 0 {
            self.measuring_since = Some(now);
        }
        // `at` is 0 if the start was not recorded.
        if !row.warm_up && row.at > 0.0 {
            self.starts.add(row.iteration, row.at);
        }
        self.failed_in_warm_up += u64::from(is_failed_warm_up(row.outcome, row.warm_up));
        if row.outcome != Outcome::Ok {
            self.first_failure
                .get_or_insert_with(|| describe_failure(row.iteration, row.outcome, row.reason.as_deref()));
        }
        let total = row.value(TotalColumn::Measured.name());
        if let Some(total) = total.filter(|_| row.is_in_statistics()) {
            self.totals.record(total);
        }
    }

    /// Returns the number of finished iterations.
    fn done(&self) -> u64 {
        self.counts.measured_with_warm_up()
    }

    /// Returns whether all iterations are finished. Only `limit.total` is compared, because the number of warm-up
    /// iterations may be unknown here.
    fn is_complete(&self) -> bool {
        self.limit.total.is_some_and(|total| self.done() >= total.get())
    }

    /// Returns the progress to be shown in this phase.
    fn report(&self, phase: Phase, trouble: Option<String>, now: MonoTime) -> ProgressReport {
        let seconds_since = |start: MonoTime| (now - start).seconds();
        let limit_s = self.limit.duration_s.zip(self.measuring_since);
        let limit_s = limit_s.map(|(seconds, since)| seconds - seconds_since(since));
        let report = ProgressReport {
            phase,
            done: self.done(),
            failed: self.counts.all_failed(),
            failed_in_warm_up: self.failed_in_warm_up,
            first_failure: self.first_failure.clone(),
            iterations: self.iterations,
            rate: self.starts.starts().actual_hz(),
            totals: self.totals.clone(),
            left_s: None,
            trouble,
        };
        let elapsed_s = self.started_at.map_or(0.0, seconds_since);
        ProgressReport { left_s: remaining_seconds(report.fraction_done(), elapsed_s, limit_s), ..report }
    }
}

/// Recorded measurements.
#[derive(Default)]
pub(super) struct RecordedRun {
    pub(super) rows: Rows,
    /// Units of the columns beyond the fixed columns, such as columns of custom code.
    pub(super) units: Units,
    /// Description of the run from its start.
    pub(super) description: Option<RunDescription>,
    /// Time of the run's end by the edge's wall clock.
    pub(super) ended_at: Option<WallTime>,
    /// The host that runs the sensor.
    pub(super) edge: Option<HostDescription>,
    /// The host that serves the model.
    pub(super) cloud: Option<Cloud>,
    /// Description of what synchronises the edge's clock.
    pub(super) edge_clock: Option<String>,
    /// Description of what synchronises the cloud's clock.
    pub(super) cloud_clock: Option<String>,
}

impl<'a> RunRecorder<'a> {
    pub(super) fn new(
        pipeline: &PipelineConfig,
        peer_timeout: Span,
        writer: RowWriter,
        clock: SharedClock,
        progress_display: &'a mut dyn ProgressDisplay,
    ) -> Self {
        let peer = match &pipeline.placement {
            PlacementConfig::Remote(remote) => Some(remote.peer.to_string()),
            PlacementConfig::Local { .. } | PlacementConfig::None {} | PlacementConfig::Observe(_) => None,
        };
        Self {
            peer_wait: PeerWait::new(clock.mono()),
            clock,
            progress_display,
            peer_timeout,
            progress: RunProgress::new(pipeline.limit, pipeline.total_iterations()),
            pipeline: pipeline.name.clone(),
            peer,
            is_refused: false,
            recorded: RecordedRun::default(),
            writer,
        }
    }

    /// Writes the rows to the file as far as the disk has space, and returns everything that was recorded.
    pub(super) fn finish(self) -> RecordedRun {
        // `ResultFolder::finish` writes rows that do not fit here to another folder, and reports it if that fails, too.
        let _ = self.writer.finish();
        self.recorded
    }

    fn record_start(&mut self, run: RunDescription) {
        let now = self.clock.mono();
        self.peer_wait.record_answer(now);
        self.progress.start(now);
        self.progress_display.show_start(&run.conditions);
        if let (Some(peer), Some(name)) = (&mut self.peer, &run.placement.peer) {
            *peer = name.to_string();
        }
        self.recorded.description = Some(run);
    }

    /// Records the hosts. It is called again after a reconnection, because the peer may be another program then.
    fn record_hosts(&mut self, running: Option<&RunningAgent>) {
        let cloud = running.and_then(|running| running.serving_cloud(&self.pipeline));
        // An ended session has no cloud any more. The last known cloud stays in the record.
        self.recorded.cloud = cloud.or(self.recorded.cloud.take());
        let Some(live) = running.map(RunningAgent::live_update) else { return };
        let clock_text = |clock: HostClock| Some(clock.text).filter(|text| !text.is_empty());
        let peer = self.recorded.cloud.as_ref().map(|cloud| cloud.id);
        let link = live.links.into_iter().find(|link| Some(link.peer) == peer);
        self.recorded.edge_clock = clock_text(live.clock).or(self.recorded.edge_clock.take());
        self.recorded.cloud_clock =
            link.and_then(|link| link.cloud).and_then(clock_text).or(self.recorded.cloud_clock.take());
    }

    fn record_row(&mut self, row: &Row) {
        // A peer answers with the error if its model fails, so a failed iteration counts as an answer, too.
        let now = self.clock.mono();
        if matches!(row.outcome, Outcome::Ok | Outcome::Failed) {
            self.peer_wait.record_answer(now);
        }
        self.progress.add(row, now);
        self.writer.write(row);
        self.recorded.rows.push(row);
    }

    fn report(&self, trouble: Option<String>) -> ProgressReport {
        let phase = match (&trouble, self.progress.started_at, self.recorded.rows.last()) {
            (_, None, _) => Phase::Starting,
            (Some(_), ..) => Phase::Waiting,
            (None, _, last) if last.is_none_or(|row| row.warm_up()) => Phase::WarmUp,
            _ => Phase::Measuring,
        };
        self.progress.report(phase, trouble, self.clock.mono())
    }
}

impl RunObserver for RunRecorder<'_> {
    type OwnReason = Infallible;

    fn handle_event(&mut self, event: Event, running: Option<&RunningAgent>) -> Option<AgentEnd> {
        match event {
            Event::RunStarted(run) => {
                self.record_start(run);
                self.recorded.edge = running.map(RunningAgent::description).or(self.recorded.edge.take());
                self.record_hosts(running);
            }
            Event::Iteration(iteration) => {
                let row = self.recorded.units.row(&iteration);
                self.record_row(&row);
            }
            Event::RunEnded(run) => {
                self.recorded.ended_at = Some(run.ended);
                // The claim of a time daemon may have arrived after the start of the run.
                self.record_hosts(running);
                return Some(AgentEnd::from_run_end(run.reason, "run"));
            }
            Event::Incident(incident) => match incident.kind {
                // After the start, the event of the run's end reports a failed pipeline, and refusals are ignored.
                IncidentKind::PipelineFailed if self.recorded.description.is_none() => {
                    return Some(AgentEnd::Failed(incident.text));
                }
                IncidentKind::Refused if self.recorded.description.is_none() => self.is_refused = true,
                IncidentKind::Connected => {
                    self.record_hosts(running);
                    // After the agent has ended, nothing waits for the peer.
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

    fn poll_state(&mut self, running: &RunningAgent) -> Option<AgentEnd> {
        // Rows reach the file even if no further row arrives.
        self.writer.flush();
        // The peer may disconnect after the last answer. The run does not wait for it then.
        if self.progress.is_complete() {
            return Some(AgentEnd::Finished);
        }
        let pipelines = running.live_update().pipelines;
        // The pipeline's last events were queued before its state changed, unless the queue was full.
        match pipelines.into_iter().next().map(|pipeline| pipeline.state) {
            Some(PipelineState::Failed(reason)) => return Some(AgentEnd::Failed(reason)),
            Some(PipelineState::Finished) => return Some(AgentEnd::Finished),
            _ => {}
        }
        let activity = PipelineActivity::current(running);
        let reason = activity.wait_reason();
        if let (true, Some(reason)) = (self.is_refused, reason) {
            return Some(AgentEnd::Failed(reason.to_owned()));
        }
        let write_error =
            self.writer.write_error().map(|error| format!("{error}; the rows are kept in memory"));
        let now = self.clock.mono();
        let slow = activity.describe_slow_sensor(now);
        let peer = match &self.peer {
            Some(peer) => peer,
            // A local model may compute on a server, which is waited for like a peer. Without a reason to wait, the
            // pipeline runs or loads its model, which may take any time.
            None if reason.is_some() => "the server of the model",
            None => {
                self.peer_wait.record_answer(now);
                let report = self.report(slow.or(write_error));
                self.progress_display.show(&report);
                return None;
            }
        };
        self.peer_wait.update(&activity, now);
        let trouble = match (&self.progress.started_at, reason) {
            // Before the start of the run, no request is open whose answer could be late.
            (None, None) => None,
            _ => self.peer_wait.describe_trouble(peer, reason, now, self.peer_timeout),
        };
        let timeout = self.peer_wait.timeout_reason(reason, now, self.peer_timeout);
        let report = self.report(slow.or(trouble).or(write_error));
        self.progress_display.show(&report);
        timeout.map(AgentEnd::Failed)
    }

    fn end_decided(&mut self) {
        let report = ProgressReport { phase: Phase::Writing, ..self.report(None) };
        self.progress_display.show(&report);
    }
}

#[cfg(test)]
mod tests {
    use peernet_analysis::record::RunRecord;
    use peernet_analysis::trust::{StartTimes, Starts};

    use super::*;

    fn row(iteration: u64, seconds: f64, warm_up: bool) -> Row {
        Row {
            iteration,
            at: 1e9 + seconds,
            episode: 0,
            step: 0,
            warm_up,
            outcome: Outcome::Ok,
            reason: None,
            values: Vec::new(),
            upload: None,
            download: None,
        }
    }

    #[test]
    fn time_limit_counts_from_end_of_warm_up() {
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        let limit = Limit { duration_s: Some(60.0), ..Limit::default() };
        let mut progress = RunProgress::new(limit, None);
        let left_s = |progress: &RunProgress, now| progress.report(Phase::Measuring, None, now).left_s;
        assert_eq!(left_s(&progress, at(0)), None, "the run has not started");
        progress.start(at(100));
        assert_eq!(left_s(&progress, at(101)), Some(59.0));
        progress.add(&row(1, 0.0, true), at(110));
        progress.add(&row(2, 10.0, false), at(120));
        // The warm-up of a later episode is part of the measured time.
        progress.add(&row(3, 20.0, true), at(130));
        assert_eq!([130, 169, 171].map(|now| left_s(&progress, at(now))), [Some(40.0), Some(1.0), Some(0.0)]);
    }

    #[test]
    fn progress_and_results_have_same_rate() {
        // Iteration 3 ends before iteration 2.
        let rows = [row(1, 0.0, true), row(3, 10.5, false), row(2, 10.0, false), row(4, 12.0, false)];
        let mut progress = RunProgress::new(Limit::default(), None);
        let rates = rows.each_ref().map(|row| {
            progress.add(row, MonoTime::from_nanos(0));
            progress.report(Phase::Measuring, None, MonoTime::from_nanos(0)).rate
        });
        let rows: Rows = rows.into_iter().collect();
        let times = StartTimes::from_run(&RunRecord::default(), &rows);
        let results = Starts { times, ..Starts::from_rows(&rows) };
        assert_eq!((rates[0], rates[3]), (None, results.actual_hz()));
        assert_eq!(rates[3], Some(1.0));
    }
}
