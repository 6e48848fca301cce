//! An iteration from its sample to the end of its actuation.

use std::time::Duration;

use peernet_clock::{MonoTime, Span};
use peernet_logger::{NodeId, Recorder, stage};
use peernet_sample::Sample;
use peernet_stream::Outcome;

use super::actuator_executor::ActuatorExecutor;
use super::load::Start;
use super::placement::{Computed, Placement};
use super::progress::Position;

/// An iteration that has begun and is not complete.
#[derive(Clone, Copy, Debug)]
pub(super) struct PendingIteration {
    pub(super) position: Position,
    pub(super) start: Start,
    /// Time at which it really began; later than intended if the pipeline was busy.
    pub(super) began_at: MonoTime,
}

/// A sample that waits until fewer iterations than the maximum are in flight.
pub(super) struct QueuedSample {
    pub(super) pending: PendingIteration,
    pub(super) log: Recorder,
    pub(super) sample: Sample,
    /// The open node `send-queue`; `None` in a closed loop, where no sample waits.
    pub(super) queued: Option<NodeId>,
}

/// An iteration with its outcome.
pub(super) struct CompletedIteration {
    pub(super) pending: PendingIteration,
    /// The label of the sample: its correct class, if the data set has labels.
    pub(super) label: Option<String>,
    pub(super) log: Recorder,
    pub(super) outcome: Outcome,
    /// The answer, if there was one.
    pub(super) answer: Option<Sample>,
    /// Sum of upload and download, if it is known.
    pub(super) transport: Option<Span>,
}

impl QueuedSample {
    /// Starts the wait of a sample for its place in flight. In a closed loop no sample waits, and no node is
    /// recorded.
    pub(super) fn new(
        pending: PendingIteration,
        mut log: Recorder,
        sample: Sample,
        closed_loop: bool,
    ) -> Self {
        let queued = (!closed_loop).then(|| log.start(stage::SEND_QUEUE));
        Self { pending, log, sample, queued }
    }

    /// Gets the answer from the placement and passes it to the actuator.
    pub(super) async fn execute(
        mut self,
        placement: &Placement,
        timeout: Duration,
        actuator_executor: Option<ActuatorExecutor>,
    ) -> CompletedIteration {
        if let Some(queued) = self.queued {
            self.log.stop(queued);
        }
        let Computed { log, result, transport } = placement.compute(self.log, &self.sample, timeout).await;
        let (log, outcome) = match (&result, actuator_executor) {
            (Ok(Some(answer)), Some(actuator_executor)) => {
                let (log, acted) = actuator_executor.act(log, &self.sample.source, answer).await;
                (log, acted.map_or_else(|error| Outcome::Failed(error.to_string()), |()| Outcome::Ok))
            }
            (Ok(_), _) => (log, Outcome::Ok),
            (Err(outcome), _) => (log, outcome.clone()),
        };
        let answer = result.ok().flatten();
        CompletedIteration {
            pending: self.pending,
            label: self.sample.label,
            log,
            outcome,
            answer,
            transport,
        }
    }
}
