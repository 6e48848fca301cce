//! State machine of a pipeline's inner loop, without I/O; `drive` waits for what it needs.

use std::io;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp};
use peernet_logger::{Recorder, RunId};
use peernet_sample::printable_line;
use peernet_stream::{IncidentKind, Outcome};
use tokio::sync::oneshot;

use super::accuracy;
use super::backoff::FailureBackoff;
use super::context::PipelineContext;
use super::in_flight::{CompletedIteration, PendingIteration, QueuedSample};
use super::iteration;
use super::load::Start;
use super::resources::PipelineResources;
use super::run::Run;
use super::sensing::{SensorOutput, SensorResponse};
use crate::incidents::IncidentContext;

/// Number of failures of the sensor in a row that are reported as an incident.
const FAILURES_FOR_INCIDENT: u32 = 10;

/// Reason for the end of the loop.
#[derive(Clone, Debug)]
pub(super) enum LoopEnd {
    /// The run reached its limit.
    Limit,
    /// The sensor has no more samples.
    NoMoreSamples,
    /// A new day began.
    Midnight,
    /// The placement is gone; the text says why.
    Disconnected(String),
    /// The agent stops.
    Stopped,
    /// The pipeline cannot go on.
    Broken(LoopError),
}

/// The reason why a pipeline's loop cannot go on.
#[derive(Clone, Debug, thiserror::Error)]
pub(super) enum LoopError {
    /// The sensor panicked.
    #[error("the sensor's thread has died; the log says why")]
    SensorDied,
    /// The kernel does not set the timer.
    #[error("the timer of the pipeline failed: {0}")]
    Timer(#[source] Arc<io::Error>),
}

/// A sample that the sensor's thread is asked for.
pub(super) struct PendingSample {
    /// The run that asked.
    pub(super) run: RunId,
    pub(super) start: Start,
    pub(super) began_at: MonoTime,
    pub(super) sample: oneshot::Receiver<SensorOutput>,
}

/// State of the loop.
///
/// An iteration is sensed, waits until fewer than the maximum are in flight, and is then in flight. One at a time is sensed or
/// waits; several may be in flight.
pub(super) struct PipelineLoop<'a> {
    pub(super) resources: &'a mut PipelineResources,
    run: &'a mut Run,
    context: &'a PipelineContext,
    waiting: Option<QueuedSample>,
    in_flight: Vec<PendingIteration>,
    ending: Option<LoopEnd>,
    backoff: FailureBackoff,
    /// Failures of the sensor since its last sample.
    sensor_failures: u32,
}

impl<'a> PipelineLoop<'a> {
    pub(super) fn new(
        resources: &'a mut PipelineResources,
        run: &'a mut Run,
        context: &'a PipelineContext,
    ) -> Self {
        let (in_flight, backoff) = (Vec::new(), FailureBackoff::default());
        let mut pipeline_loop = Self {
            resources,
            run,
            context,
            waiting: None,
            in_flight,
            ending: None,
            backoff,
            sensor_failures: 0,
        };
        pipeline_loop.resume_pending_sample();
        pipeline_loop
    }

    /// Continues to wait for a sample that was requested before the connection was lost. A sample that arrived while
    /// there was no connection is recorded as lost, because it is old by now.
    fn resume_pending_sample(&mut self) {
        let came = self.resources.sensing.as_mut().and_then(|awaited| awaited.sample.try_recv().ok());
        let since =
            self.resources.sensing.as_ref().filter(|_| came.is_none()).map(|awaited| awaited.began_at);
        // The live state says since when the pipeline waits for its sensor, also across a reconnect.
        self.resources.display.set_sensor_busy_since(since);
        let Some(SensorOutput { log, sample }) = came else { return };
        let Some(PendingSample { run, start, began_at, .. }) = self.resources.sensing.take() else { return };
        // The end of the sensor, its failure, and a sample of an earlier run mean the same with and without a
        // connection.
        if !matches!(sample, Ok(Some(_))) || run != self.run.id() {
            return self.accept_sample(run, (start, began_at), SensorOutput { log, sample });
        }
        let pending = PendingIteration { position: self.run.place(start.intended), start, began_at };
        let reason = "there was no connection when the sample was there".to_owned();
        self.finish(pending, log, Outcome::Lost(reason), None, self.context.host.clock.stamp());
    }

    /// Returns the waiting sample if another iteration may be in flight.
    pub(super) fn launch(&mut self) -> Option<QueuedSample> {
        let max_in_flight = self.resources.max_in_flight();
        let ready = self.waiting.take_if(|_| self.in_flight.len() < max_in_flight)?;
        self.in_flight.push(ready.pending);
        Some(ready)
    }

    /// Begins an iteration if it is time for one. Returns whether something happened.
    pub(super) fn begin(&mut self) -> bool {
        if !self.may_begin() {
            return false;
        }
        let clock = &self.context.host.clock;
        let now = clock.mono();
        // Checked before a start is taken from the schedule, so that the start belongs to the next run.
        if self.run.is_from_previous_day(clock.wall()) {
            self.ending = Some(LoopEnd::Midnight);
            return true;
        }
        let next = self.resources.schedule.next_at(now);
        if self.run.is_over(next) {
            self.ending = Some(LoopEnd::Limit);
            return true;
        }
        // Checked last: a run that is over does not wait for the pause.
        if self.backoff.paused_until(now).is_some() {
            return false;
        }
        let Some(start) = self.resources.schedule.take(now) else { return false };
        let (log, began_at) = iteration::begin(clock, self.context.host.id, start.intended);
        match self.resources.sensor.begin(log) {
            SensorResponse::Done(sensed) => self.accept_sample(self.run.id(), (start, began_at), sensed),
            SensorResponse::Pending(sample) => {
                self.resources.sensing = Some(PendingSample { run: self.run.id(), start, began_at, sample });
                self.resources.display.set_sensor_busy_since(Some(began_at));
            }
        }
        true
    }

    /// Returns when [`begin`](Self::begin) is to be called again if nothing else happens.
    pub(super) fn wakes_at(&mut self) -> Option<MonoTime> {
        if !self.may_begin() {
            return None;
        }
        let now = self.context.host.clock.mono();
        self.backoff.paused_until(now).or_else(|| Some(self.resources.schedule.next_at(now)))
    }

    /// Ends the loop: no further iteration begins. Of several reasons the first counts.
    pub(super) fn end(&mut self, reason: LoopEnd) {
        self.ending.get_or_insert(reason);
    }

    /// Returns the reason for the end once every iteration that had begun is complete.
    pub(super) fn ended(&self) -> Option<LoopEnd> {
        let ending = self.ending.clone()?;
        // A slow sensor must not delay reconnecting.
        let sensed = self.resources.sensing.is_none() || matches!(ending, LoopEnd::Disconnected(_));
        (sensed && self.waiting.is_none() && self.in_flight.is_empty()).then_some(ending)
    }

    /// Handles the answer of the sensor's thread.
    pub(super) fn sensed(&mut self, sensed: SensorOutput) {
        if let Some(PendingSample { run, start, began_at, .. }) = self.resources.sensing.take() {
            self.resources.display.set_sensor_busy_since(None);
            self.accept_sample(run, (start, began_at), sensed);
        }
    }

    /// Handles the end of the sensor's thread, which will not answer any more.
    pub(super) fn sensor_died(&mut self) {
        self.resources.sensing = None;
        self.resources.display.set_sensor_busy_since(None);
        self.end(LoopEnd::Broken(LoopError::SensorDied));
    }

    /// Handles an iteration whose answer has arrived, or will not arrive.
    pub(super) fn complete(&mut self, completed: CompletedIteration) {
        let CompletedIteration { pending, label, mut log, outcome, answer, transport } = completed;
        self.in_flight.retain(|other| other.position.number != pending.position.number);
        let ended = self.context.host.clock.stamp();
        // After the end of the iteration was stamped, so that computing the accuracy adds no latency.
        if let (Some(answer), Some(label)) = (answer, label) {
            accuracy::judge(&mut log, &label, &answer);
        }
        self.finish(pending, log, outcome, transport, ended);
    }

    /// Records all iterations in flight as lost.
    pub(super) fn abandon(&mut self, reason: &str) {
        let waiting = self.waiting.take().map(|waiting| waiting.pending);
        for pending in std::mem::take(&mut self.in_flight).into_iter().chain(waiting) {
            // The peer or the model has the recorder with what was measured. Only the beginning is known here.
            let (log, _) =
                iteration::begin(&self.context.host.clock, self.context.host.id, pending.start.intended);
            let ended = self.context.host.clock.stamp();
            self.finish(pending, log, Outcome::Lost(reason.to_owned()), None, ended);
        }
    }

    fn may_begin(&self) -> bool {
        let idle = self.ending.is_none() && self.resources.sensing.is_none() && self.waiting.is_none();
        // A closed loop starts the next iteration when the last one is complete, an open loop also while others are
        // in flight.
        idle && (self.in_flight.is_empty() || !self.resources.schedule.is_closed())
    }

    /// Numbers the iteration of a sample, or records the failure of the sensor.
    ///
    /// A sample that was requested by an earlier run is dropped: it began before this run, and that run has ended.
    fn accept_sample(
        &mut self,
        run: RunId,
        (start, began_at): (Start, MonoTime),
        SensorOutput { log, sample }: SensorOutput,
    ) {
        if run != self.run.id() && !matches!(sample, Ok(None)) {
            let pipeline = &self.resources.config.name;
            return tracing::info!(%pipeline, "left out: a sample that was asked for in the run before this one");
        }
        let mut pending = || PendingIteration { position: self.run.place(start.intended), start, began_at };
        match sample {
            // No iteration is numbered, because there is no sample.
            Ok(None) => self.end(LoopEnd::NoMoreSamples),
            Ok(Some(sample)) => {
                let pending = pending();
                self.sensor_failures = 0;
                self.waiting =
                    Some(QueuedSample::new(pending, log, sample, self.resources.schedule.is_closed()));
            }
            Err(error) => {
                let pending = pending();
                let reason = printable_line(&error.to_string()).into_owned();
                self.sensor_failures = self.sensor_failures.saturating_add(1);
                // Exactly at the threshold, so that a row of failures is one incident.
                if self.sensor_failures == FAILURES_FOR_INCIDENT {
                    self.report_sensor_failures(&reason);
                }
                let ended = self.context.host.clock.stamp();
                self.finish(pending, log, Outcome::Failed(reason), None, ended);
            }
        }
    }

    /// Reports the failures of the sensor as an incident.
    fn report_sensor_failures(&self, reason: &str) {
        let what = IncidentContext {
            pipeline: Some(&self.resources.config.name),
            run: Some(self.run.id()),
            ..IncidentContext::default()
        };
        let text = format!(
            "no sample in {FAILURES_FOR_INCIDENT} iterations in a row: {reason}; the pipeline goes on trying"
        );
        self.context.events.incidents.report(IncidentKind::PipelineFailed, what, text);
    }

    fn finish(
        &mut self,
        pending: PendingIteration,
        log: Recorder,
        outcome: Outcome,
        transport: Option<Span>,
        ended: Stamp,
    ) {
        let outcome = with_printable_reason(outcome);
        let closed_loop = self.resources.schedule.is_closed();
        if closed_loop {
            // Only a closed loop would repeat failures as fast as it can. An open loop keeps its rate.
            self.backoff.record_outcome(&outcome, ended.mono);
        }
        let tree = iteration::close(log, &pending, ended.mono, closed_loop, transport);
        self.run.record(pending.position, outcome, tree, ended, self.context, &self.resources.display);
    }
}

/// Returns the outcome with its reason as one printable line: a table cell. The reason of a sensor or a model may be a traceback.
fn with_printable_reason(outcome: Outcome) -> Outcome {
    match outcome {
        Outcome::Failed(reason) => Outcome::Failed(printable_line(&reason).into_owned()),
        Outcome::Lost(reason) => Outcome::Lost(printable_line(&reason).into_owned()),
        other @ (Outcome::Ok | Outcome::Timeout) => other,
    }
}
