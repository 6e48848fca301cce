//! The state of a pipeline's inner loop and its transitions; waiting is in `drive`.

use std::io;
use std::sync::Arc;

use peernet_clock::{MonoTime, Span, Stamp};
use peernet_logger::{Recorder, RunId};
use peernet_sample::printable_line;
use peernet_stream::{IncidentKind, Outcome};
use tokio::sync::oneshot;

use super::accuracy;
use super::brake::Brake;
use super::context::PipelineContext;
use super::flight::{Landed, Ticket, Waiting};
use super::iteration;
use super::line::Line;
use super::load::Start;
use super::run::Run;
use super::sensing::{Sensed, Sensing};
use crate::incidents::Concerning;

/// So many samples in a row that could not be had are worth an incident.
const BLIND: u32 = 10;

/// Why the loop ended.
#[derive(Clone, Debug)]
pub(super) enum Ended {
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
pub(super) struct Awaited {
    /// The run that asked.
    pub(super) run: RunId,
    pub(super) start: Start,
    pub(super) begun: MonoTime,
    pub(super) sample: oneshot::Receiver<Sensed>,
}

/// Where the loop stands.
///
/// One iteration at a time is sensed, then waits for a place, then is aloft; only being aloft is possible for
/// several at once.
pub(super) struct Cycle<'a> {
    pub(super) line: &'a mut Line,
    run: &'a mut Run,
    context: &'a PipelineContext,
    waiting: Option<Waiting>,
    aloft: Vec<Ticket>,
    ending: Option<Ended>,
    brake: Brake,
    /// Samples in a row that the sensor did not give.
    blind: u32,
}

impl<'a> Cycle<'a> {
    pub(super) fn new(line: &'a mut Line, run: &'a mut Run, context: &'a PipelineContext) -> Self {
        let (aloft, brake) = (Vec::new(), Brake::default());
        let mut cycle = Self { line, run, context, waiting: None, aloft, ending: None, brake, blind: 0 };
        cycle.take_up();
        cycle
    }

    /// A sample that was asked for before the connection was lost is waited for on. One that came meanwhile came when
    /// there was nobody to send it to; now it is old.
    fn take_up(&mut self) {
        let came = self.line.sensing.as_mut().and_then(|awaited| awaited.sample.try_recv().ok());
        let since = self.line.sensing.as_ref().filter(|_| came.is_none()).map(|awaited| awaited.begun);
        self.line.display.set_senses_since(since);
        let Some(Sensed { log, sample }) = came else { return };
        let Some(Awaited { run, start, begun, .. }) = self.line.sensing.take() else { return };
        if !matches!(sample, Ok(Some(_))) || run != self.run.id() {
            return self.judge(run, (start, begun), Sensed { log, sample });
        }
        let ticket = Ticket { position: self.run.place(start.intended), start, begun };
        let reason = "there was no connection when the sample was there".to_owned();
        self.finish(ticket, log, Outcome::Lost(reason), None, self.context.host.clock.stamp());
    }

    /// The sample that may be sent now: there is one, and a place for it.
    pub(super) fn launch(&mut self) -> Option<Waiting> {
        let places = self.line.places();
        let ready = self.waiting.take_if(|_| self.aloft.len() < places)?;
        self.aloft.push(ready.ticket);
        Some(ready)
    }

    /// Begins an iteration if it is time for one. Returns whether something happened.
    pub(super) fn begin(&mut self) -> bool {
        if !self.may_begin() {
            return false;
        }
        let clock = &self.context.host.clock;
        let now = clock.mono();
        if self.run.is_yesterdays(clock.wall()) {
            self.ending = Some(Ended::Midnight);
            return true;
        }
        let next = self.line.schedule.next_at(now);
        if self.run.is_over(next) {
            self.ending = Some(Ended::Limit);
            return true;
        }
        // Asked last: a run that is over does not wait.
        if self.brake.holds_until(now).is_some() {
            return false;
        }
        let Some(start) = self.line.schedule.take(now) else { return false };
        let (log, begun) = iteration::begin(clock, self.context.host.id, start.intended);
        match self.line.senses.begin(log) {
            Sensing::Done(sensed) => self.judge(self.run.id(), (start, begun), sensed),
            Sensing::Pending(sample) => {
                self.line.sensing = Some(Awaited { run: self.run.id(), start, begun, sample });
                self.line.display.set_senses_since(Some(begun));
            }
        }
        true
    }

    /// When the loop has to look again even if nothing happens.
    pub(super) fn wakes_at(&mut self) -> Option<MonoTime> {
        if !self.may_begin() {
            return None;
        }
        let now = self.context.host.clock.mono();
        self.brake.holds_until(now).or_else(|| Some(self.line.schedule.next_at(now)))
    }

    /// Nothing begins any more. The first reason counts.
    pub(super) fn end(&mut self, reason: Ended) {
        self.ending.get_or_insert(reason);
    }

    /// Why the loop is over, once everything that had begun is done.
    pub(super) fn ended(&self) -> Option<Ended> {
        let ending = self.ending.clone()?;
        // A sensor may take its time: the connection is sought again meanwhile.
        let sensed = self.line.sensing.is_none() || matches!(ending, Ended::Disconnected(_));
        (sensed && self.waiting.is_none() && self.aloft.is_empty()).then_some(ending)
    }

    /// The sensor's thread has answered.
    pub(super) fn sensed(&mut self, sensed: Sensed) {
        if let Some(Awaited { run, start, begun, .. }) = self.line.sensing.take() {
            self.line.display.set_senses_since(None);
            self.judge(run, (start, begun), sensed);
        }
    }

    /// The sensor's thread will never answer.
    pub(super) fn sensor_died(&mut self) {
        self.line.sensing = None;
        self.line.display.set_senses_since(None);
        self.end(Ended::Broken(LoopError::SensorDied));
    }

    /// An iteration came back.
    pub(super) fn land(&mut self, landed: Landed) {
        let Landed { ticket, label, mut log, outcome, answer, transport } = landed;
        self.aloft.retain(|other| other.position.number != ticket.position.number);
        let ended = self.context.host.clock.stamp();
        // Judged after the end: what a study of accuracy costs is no latency.
        if let (Some(answer), Some(label)) = (answer, label) {
            accuracy::judge(&mut log, &label, &answer);
        }
        self.finish(ticket, log, outcome, transport, ended);
    }

    /// Gives up what is under way: it is recorded as lost.
    pub(super) fn abandon(&mut self, reason: &str) {
        let waiting = self.waiting.take().map(|waiting| waiting.ticket);
        for ticket in std::mem::take(&mut self.aloft).into_iter().chain(waiting) {
            // What was measured is with the peer or the model; what remains is that it began.
            let (log, _) =
                iteration::begin(&self.context.host.clock, self.context.host.id, ticket.start.intended);
            let ended = self.context.host.clock.stamp();
            self.finish(ticket, log, Outcome::Lost(reason.to_owned()), None, ended);
        }
    }

    fn may_begin(&self) -> bool {
        let idle = self.ending.is_none() && self.line.sensing.is_none() && self.waiting.is_none();
        idle && (self.aloft.is_empty() || !self.line.schedule.is_closed())
    }

    /// Gives the iteration its number, now that it is known to be one.
    ///
    /// What an earlier run asked for, when the peer then came back as another one, is an iteration of neither: it began
    /// before this run, and that one has ended.
    fn judge(&mut self, run: RunId, (start, begun): (Start, MonoTime), Sensed { log, sample }: Sensed) {
        if run != self.run.id() && !matches!(sample, Ok(None)) {
            let pipeline = &self.line.config.name;
            return tracing::info!(%pipeline, "left out: a sample that was asked for in the run before this one");
        }
        let mut ticket = || Ticket { position: self.run.place(start.intended), start, begun };
        match sample {
            Ok(None) => self.end(Ended::NoMoreSamples),
            Ok(Some(sample)) => {
                let ticket = ticket();
                self.blind = 0;
                self.waiting = Some(Waiting::new(ticket, log, sample, self.line.schedule.is_closed()));
            }
            Err(error) => {
                let ticket = ticket();
                let reason = printable_line(&error.to_string()).into_owned();
                self.blind = self.blind.saturating_add(1);
                if self.blind == BLIND {
                    self.report_blindness(&reason);
                }
                let ended = self.context.host.clock.stamp();
                self.finish(ticket, log, Outcome::Failed(reason), None, ended);
            }
        }
    }

    /// Said once until there is a sample again.
    fn report_blindness(&self, reason: &str) {
        let what = Concerning {
            pipeline: Some(&self.line.config.name),
            run: Some(self.run.id()),
            ..Concerning::default()
        };
        let text = format!("no sample in {BLIND} iterations in a row: {reason}; the pipeline goes on trying");
        self.context.events.incidents.report(IncidentKind::PipelineFailed, what, text);
    }

    fn finish(
        &mut self,
        ticket: Ticket,
        log: Recorder,
        outcome: Outcome,
        transport: Option<Span>,
        ended: Stamp,
    ) {
        let outcome = with_printable_reason(outcome);
        let closed_loop = self.line.schedule.is_closed();
        if closed_loop {
            self.brake.note(&outcome, ended.mono);
        }
        let tree = iteration::close(log, &ticket, ended.mono, closed_loop, transport);
        self.run.record(ticket.position, outcome, tree, ended, self.context, &self.line.display);
    }
}

/// A reason is a cell of a table and ends up on terminals, whoever gave it: a sensor's or a model's may be a traceback.
fn with_printable_reason(outcome: Outcome) -> Outcome {
    match outcome {
        Outcome::Failed(reason) => Outcome::Failed(printable_line(&reason).into_owned()),
        Outcome::Lost(reason) => Outcome::Lost(printable_line(&reason).into_owned()),
        other @ (Outcome::Ok | Outcome::Timeout) => other,
    }
}
