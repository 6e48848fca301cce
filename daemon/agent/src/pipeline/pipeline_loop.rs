//! State machine of a pipeline's inner loop. It does not wait for anything; `drive` does.

mod episodes;

use std::io;
use std::sync::Arc;

use peernet_actuators::Feedback;
use peernet_clock::{LogThrottle, MonoTime, Span, Stamp};
use peernet_logger::{Recorder, RunId};
use peernet_sample::printable_line;
use peernet_stream::{IncidentKind, Outcome};
use tokio::sync::oneshot;

use super::accuracy;
use super::backoff::FailureBackoff;
use super::context::PipelineContext;
use super::in_flight::{CompletedIteration, QueuedSample, StartedIteration};
use super::iteration;
use super::load::Start;
use super::resources::PipelineResources;
use super::run::Run;
use super::sensing::{SensorOutput, SensorResponse};
use crate::incidents::IncidentSubject;

/// Number of consecutive sensor failures after which an incident is reported.
// A few consecutive failures may come from bad samples of a data set. They are recorded as failed iterations only.
const FAILURES_FOR_INCIDENT: u32 = 10;

/// Reason for the end of the loop.
#[derive(Clone, Debug)]
pub(super) enum LoopEnd {
    /// The run reached its limit.
    Limit,
    /// The sensor has no more samples.
    NoMoreSamples,
    /// A new day (UTC) began.
    Midnight,
    /// The connection to the peer is lost; the text is the reason. The run may have reached its limit.
    Disconnected(String),
    /// The agent stops.
    Stopped,
    /// The pipeline cannot continue.
    Broken(LoopError),
}

/// Reason why a pipeline's loop cannot continue.
#[derive(Clone, Debug, thiserror::Error)]
pub(super) enum LoopError {
    /// The sensor panicked.
    #[error("the sensor's thread has panicked; see the log for the reason")]
    SensorDied,
    /// The kernel refuses to set the timer.
    #[error("the timer for the starts of iterations failed: {0}")]
    Timer(#[source] Arc<io::Error>),
}

/// A sample that was requested from the sensor's thread.
pub(super) struct PendingSample {
    /// The run that requested it.
    pub(super) run: RunId,
    pub(super) start: Start,
    pub(super) started_at: MonoTime,
    pub(super) sample: oneshot::Receiver<SensorOutput>,
}

/// State of the loop.
///
/// An iteration first waits for its sample, then until fewer iterations than the maximum are in flight, and is then in
/// flight. At most one iteration waits for its sample or in the queue; several may be in flight.
pub(super) struct PipelineLoop<'a> {
    pub(super) resources: &'a mut PipelineResources,
    run: &'a mut Run,
    context: &'a PipelineContext,
    queued: Option<QueuedSample>,
    in_flight: Vec<StartedIteration>,
    /// Reason for the end; set once no further iteration starts.
    end_reason: Option<LoopEnd>,
    /// Pauses between iterations of a closed loop that fail.
    iteration_backoff: FailureBackoff,
    /// Number of failures of the sensor since its latest sample.
    consecutive_sensor_failures: u32,
    /// Pauses between preparations that fail.
    preparation_backoff: FailureBackoff,
    /// Limits log lines about answers that are not scored.
    unscored_answers: LogThrottle,
}

impl<'a> PipelineLoop<'a> {
    pub(super) fn new(
        resources: &'a mut PipelineResources,
        run: &'a mut Run,
        context: &'a PipelineContext,
    ) -> Self {
        let (in_flight, iteration_backoff) = (Vec::new(), FailureBackoff::default());
        let mut pipeline_loop = Self {
            resources,
            run,
            context,
            queued: None,
            in_flight,
            end_reason: None,
            iteration_backoff,
            consecutive_sensor_failures: 0,
            preparation_backoff: FailureBackoff::default(),
            unscored_answers: LogThrottle::default(),
        };
        pipeline_loop.resume_pending_sample();
        pipeline_loop
    }

    /// Continues to wait for a sample that was requested before the connection was lost. A sample that arrived in the
    /// meantime is recorded as lost.
    fn resume_pending_sample(&mut self) {
        let output = self
            .resources
            .pending_sample
            .as_mut()
            .and_then(|pending_sample| pending_sample.sample.try_recv().ok());
        let since = self
            .resources
            .pending_sample
            .as_ref()
            .filter(|_| output.is_none())
            .map(|pending_sample| pending_sample.started_at);
        // The wait for the sensor continues over a reconnect, so the live state keeps the time of the request.
        self.resources.live_state.set_sensor_busy_since(since);
        let Some(SensorOutput { log, sample }) = output else { return };
        let Some(PendingSample { run, start, started_at, .. }) = self.resources.pending_sample.take() else {
            return;
        };
        // The end of the sensor's samples, a failure of the sensor, and a sample of an earlier run are handled as if
        // there had been a connection.
        if !matches!(sample, Ok(Some(_))) || run != self.run.id() {
            return self.accept_sample(run, (start, started_at), SensorOutput { log, sample });
        }
        let iteration =
            StartedIteration { position: self.run.assign_position(start.intended), start, started_at };
        // The sample is too old to be sent after the reconnect: its latency would include the outage.
        let reason = "the sample arrived while there was no connection".to_owned();
        self.finish(iteration, log, Outcome::Lost(reason), Feedback::default(), None);
    }

    /// Takes the queued sample if fewer iterations than the maximum are in flight.
    pub(super) fn dequeue_sample(&mut self) -> Option<QueuedSample> {
        let max_in_flight = self.resources.max_in_flight();
        let queued_sample = self.queued.take_if(|_| self.in_flight.len() < max_in_flight)?;
        self.in_flight.push(queued_sample.iteration);
        Some(queued_sample)
    }

    /// Does what is due now: ends the loop, starts a preparation, or starts an iteration. Returns `false` if nothing is
    /// due.
    pub(super) fn perform_due_action(&mut self) -> bool {
        self.end_reported_episode();
        if !self.can_start() {
            return false;
        }
        let clock = &self.context.host.clock;
        let now = clock.mono();
        // Checked before a start is taken from the schedule, so that the start belongs to the next run.
        if self.run.is_from_previous_day(clock.wall()) {
            self.end_reason = Some(LoopEnd::Midnight);
            return true;
        }
        let preparation = self.due_preparation();
        // A preparation skips the starts that came due while the earlier iterations were completed, so the limit is
        // checked for the present time.
        let next_start = if preparation.is_some() { now } else { self.resources.schedule.next_at(now) };
        if self.run.is_limit_reached(next_start) {
            self.end_reason = Some(LoopEnd::Limit);
            return true;
        }
        // Checked after the limit: a run that has reached it must not wait for the end of a pause.
        if self.paused_until(now).is_some() {
            return false;
        }
        if let Some(preparation) = preparation {
            self.resources.start_preparation(preparation, now);
            return true;
        }
        let Some(start) = self.resources.schedule.take(now) else { return false };
        let (log, started_at) = iteration::start(clock, self.context.host.id, start.intended);
        self.resources.is_reset = false;
        match self.resources.sensor.request_sample(log) {
            SensorResponse::Done(output) => self.accept_sample(self.run.id(), (start, started_at), output),
            SensorResponse::Pending(sample) => {
                self.resources.pending_sample =
                    Some(PendingSample { run: self.run.id(), start, started_at, sample });
                self.resources.live_state.set_sensor_busy_since(Some(started_at));
            }
        }
        true
    }

    /// Returns the time at which [`perform_due_action`](Self::perform_due_action) must be called again if no event
    /// occurs before.
    pub(super) fn next_wakeup(&mut self) -> Option<MonoTime> {
        if !self.can_start() {
            return None;
        }
        let now = self.context.host.clock.mono();
        self.paused_until(now).or_else(|| Some(self.resources.schedule.next_at(now)))
    }

    /// Ends the loop: no further iteration starts. If it is called several times, the first reason is kept.
    pub(super) fn end(&mut self, reason: LoopEnd) {
        self.end_reason.get_or_insert(reason);
    }

    /// Returns the reason for the end once every iteration that started is complete; `None` before.
    pub(super) fn end_reason(&self) -> Option<LoopEnd> {
        let reason = self.end_reason.clone()?;
        // After a disconnect the loop does not wait for the sensor, because a slow sensor must not delay reconnecting.
        let is_sensing =
            self.resources.pending_sample.is_some() && !matches!(reason, LoopEnd::Disconnected(_));
        (!is_sensing && self.queued.is_none() && self.in_flight.is_empty()).then_some(reason)
    }

    /// Handles the output of the sensor's thread.
    pub(super) fn handle_sensor_output(&mut self, output: SensorOutput) {
        if let Some(PendingSample { run, start, started_at, .. }) = self.resources.pending_sample.take() {
            self.resources.live_state.set_sensor_busy_since(None);
            self.accept_sample(run, (start, started_at), output);
        }
    }

    /// Handles the unexpected end of the sensor's thread.
    pub(super) fn handle_sensor_death(&mut self) {
        self.resources.pending_sample = None;
        self.resources.live_state.set_sensor_busy_since(None);
        self.end(LoopEnd::Broken(LoopError::SensorDied));
    }

    /// Handles an iteration whose answer has arrived, or will not arrive.
    pub(super) fn complete(&mut self, completed: CompletedIteration) {
        let CompletedIteration { iteration, label, mut log, outcome, answer, feedback, transport } =
            completed;
        self.in_flight.retain(|other| other.position.number != iteration.position.number);
        let ended = self.context.host.clock.stamp();
        // Computed after the end of the iteration was stamped, so that the computation adds no latency.
        if let (Some(answer), Some(label)) = (answer, label)
            && let Err(error) = accuracy::record_accuracy(&mut log, &label, &answer)
            // A data set without its masks would otherwise fill the log.
            && let Some(times) = self.unscored_answers.count_event("mask", None, ended.mono)
        {
            let pipeline = &self.resources.config.name;
            tracing::warn!(
                %error, %pipeline, times,
                "an answer is not scored, because the mask of its picture cannot be used; correct the file (logged at most once a \
                 minute, with the count)"
            );
        }
        self.finish_at(ended, iteration, log, outcome, feedback, transport);
    }

    /// Records all iterations that are in flight, or wait in the queue, as lost.
    pub(super) fn abandon(&mut self, reason: &str) {
        let queued = self.queued.take().map(|queued| queued.iteration);
        for iteration in std::mem::take(&mut self.in_flight).into_iter().chain(queued) {
            // The peer or the model still has the recorder with the measurements, so a new recorder is started here.
            let (log, _) =
                iteration::start(&self.context.host.clock, self.context.host.id, iteration.start.intended);
            self.finish(iteration, log, Outcome::Lost(reason.to_owned()), Feedback::default(), None);
        }
    }

    /// Returns whether the next iteration, or the preparation for it, may start as soon as it is due.
    fn can_start(&self) -> bool {
        let is_idle = self.end_reason.is_none()
            && !self.has_outstanding_sample()
            && self.resources.pending_preparation.is_none();
        // A closed loop and a simulation start the next iteration when the previous iteration is complete. An open loop
        // starts the next iteration also while others are in flight, unless a preparation is due: all iterations in
        // flight have to end before the preparation.
        let may_overlap = self.resources.iterations_may_overlap() && self.due_preparation().is_none();
        is_idle && (self.in_flight.is_empty() || may_overlap)
    }

    /// Returns whether a sample is requested from the sensor, or waits in the queue.
    fn has_outstanding_sample(&self) -> bool {
        self.resources.pending_sample.is_some() || self.queued.is_some()
    }

    /// Returns the end of the pause after failures; `None` if the loop does not pause.
    fn paused_until(&self, now: MonoTime) -> Option<MonoTime> {
        // `None` is less than any time.
        self.iteration_backoff.paused_until(now).max(self.preparation_backoff.paused_until(now))
    }

    /// Queues a sample as the next iteration, records a failure of the sensor, or ends the loop at the end of samples.
    ///
    /// A sample that an earlier run requested is dropped: its iteration started before this run, and that run has
    /// ended.
    fn accept_sample(
        &mut self,
        run: RunId,
        (start, started_at): (Start, MonoTime),
        SensorOutput { log, sample }: SensorOutput,
    ) {
        if run != self.run.id() && !matches!(sample, Ok(None)) {
            let pipeline = &self.resources.config.name;
            return tracing::info!(%pipeline, "dropped a sample that the previous run had requested");
        }
        let mut new_iteration =
            || StartedIteration { position: self.run.assign_position(start.intended), start, started_at };
        match sample {
            // No position is assigned, because without a sample there is no iteration.
            Ok(None) => self.end(LoopEnd::NoMoreSamples),
            Ok(Some(sample)) => {
                let iteration = new_iteration();
                self.consecutive_sensor_failures = 0;
                let closed_loop = self.resources.schedule.is_closed();
                self.queued = Some(QueuedSample::new(self.run.id(), iteration, log, sample, closed_loop));
            }
            Err(error) => {
                let iteration = new_iteration();
                let reason = printable_line(&error.to_string()).into_owned();
                self.consecutive_sensor_failures = self.consecutive_sensor_failures.saturating_add(1);
                // Reported exactly at the threshold, so that a series of failures is one incident.
                if self.consecutive_sensor_failures == FAILURES_FOR_INCIDENT {
                    self.report_sensor_failures(&reason);
                }
                let reason = format!("the sensor failed: {reason}");
                self.finish(iteration, log, Outcome::Failed(reason), Feedback::default(), None);
            }
        }
    }

    /// Reports the failures of the sensor as an incident.
    fn report_sensor_failures(&self, reason: &str) {
        let subject = IncidentSubject {
            pipeline: Some(&self.resources.config.name),
            run: Some(self.run.id()),
            ..IncidentSubject::default()
        };
        let text = format!(
            "the sensor failed in {FAILURES_FOR_INCIDENT} consecutive iterations: {reason}; the pipeline keeps trying"
        );
        self.context.events.incidents.report(IncidentKind::PipelineFailed, subject, text);
    }

    /// Records an iteration that ends now.
    fn finish(
        &mut self,
        iteration: StartedIteration,
        log: Recorder,
        outcome: Outcome,
        feedback: Feedback,
        transport: Option<Span>,
    ) {
        let ended = self.context.host.clock.stamp();
        self.finish_at(ended, iteration, log, outcome, feedback, transport);
    }

    /// Records an iteration that ended at `ended`.
    fn finish_at(
        &mut self,
        ended: Stamp,
        iteration: StartedIteration,
        log: Recorder,
        outcome: Outcome,
        feedback: Feedback,
        transport: Option<Span>,
    ) {
        let outcome = with_printable_reason(outcome);
        let closed_loop = self.resources.schedule.is_closed();
        if closed_loop {
            // Only a closed loop repeats failures as fast as it can. The rate of an open loop limits them.
            self.iteration_backoff.record_outcome(&outcome, ended.mono);
        }
        let episode = iteration.position.episode;
        let has_pending = self.has_pending(episode);
        let result = self.run.add_feedback(episode, &feedback, has_pending);
        let mut tree = iteration::close(log, &iteration, ended.mono, closed_loop, transport);
        if let Some(result) = result {
            result.record(&mut tree, ended.mono - iteration.start.intended);
        }
        self.resources.extend_pending_advance(ended.mono - iteration.start.intended);
        self.run.record(iteration.position, outcome, tree, ended, self.context, &self.resources.live_state);
    }
}

/// Returns the outcome with its reason as one printable line, for a table cell. The reason of a sensor or a model may
/// be a traceback.
fn with_printable_reason(outcome: Outcome) -> Outcome {
    match outcome {
        Outcome::Failed(reason) => Outcome::Failed(printable_line(&reason).into_owned()),
        Outcome::Lost(reason) => Outcome::Lost(printable_line(&reason).into_owned()),
        Outcome::Timeout(reason) => Outcome::Timeout(printable_line(&reason).into_owned()),
        Outcome::Ok => Outcome::Ok,
    }
}
