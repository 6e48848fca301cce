//! An iteration from its sample to the end of its actuation: queued, in flight, completed.

use std::time::Duration;

use peernet_actuators::Feedback;
use peernet_clock::{MonoTime, Span};
use peernet_logger::{NodeId, Recorder, RunId, stage};
use peernet_sample::Sample;
use peernet_stream::Outcome;

use super::actuator_executor::{ActuatorExecutor, AnsweredSample};
use super::load::Start;
use super::placement::{ComputationResult, Placement};
use super::progress::Position;

/// Position and start of an iteration that has started.
#[derive(Clone, Copy, Debug)]
pub(super) struct StartedIteration {
    pub(super) position: Position,
    pub(super) start: Start,
    /// Actual start; later than the intended one if the pipeline was busy.
    pub(super) started_at: MonoTime,
}

/// A sample that waits until fewer iterations than the maximum are in flight.
pub(super) struct QueuedSample {
    /// The run of the iteration.
    pub(super) run: RunId,
    pub(super) iteration: StartedIteration,
    pub(super) log: Recorder,
    pub(super) sample: Sample,
    /// The open node `send-queue`; `None` in a closed loop, where no sample waits.
    pub(super) queue_node: Option<NodeId>,
}

/// An iteration with its outcome.
pub(super) struct CompletedIteration {
    pub(super) iteration: StartedIteration,
    /// Label of the sample, which is its correct class; `None` if the data set has no labels.
    pub(super) label: Option<String>,
    pub(super) log: Recorder,
    pub(super) outcome: Outcome,
    /// The answer, if there was one.
    pub(super) answer: Option<Sample>,
    /// Feedback of the actuator; all fields are empty if the actuator did not act or reported nothing.
    pub(super) feedback: Feedback,
    /// Sum of upload and download, if it is known.
    pub(super) transport: Option<Span>,
}

impl QueuedSample {
    /// Queues a sample and starts the node `send-queue`. In a closed loop no sample waits, so the node is omitted.
    pub(super) fn new(
        run: RunId,
        iteration: StartedIteration,
        mut log: Recorder,
        sample: Sample,
        closed_loop: bool,
    ) -> Self {
        let queue_node = (!closed_loop).then(|| log.start(stage::SEND_QUEUE));
        Self { run, iteration, log, sample, queue_node }
    }

    /// Gets the answer from the placement and passes it to the actuator.
    pub(super) async fn execute(
        mut self,
        placement: &Placement,
        timeout: Duration,
        actuator_executor: Option<ActuatorExecutor>,
    ) -> CompletedIteration {
        if let Some(queue_node) = self.queue_node {
            self.log.stop(queue_node);
        }
        let ComputationResult { log, result, transport } =
            placement.compute(self.log, &self.sample, timeout).await;
        let (log, act_result) = match (&result, actuator_executor) {
            (Ok(Some(answer)), Some(actuator_executor)) => {
                let position = self.iteration.position;
                let answered = AnsweredSample { run: self.run, position, source: &self.sample.source };
                let (log, act_result) = actuator_executor.act(log, answered, answer).await;
                (log, act_result.map_err(|error| Outcome::Failed(format!("the actuator failed: {error}"))))
            }
            // There is nothing to act on, or no actuator. A sensor alone has no answer.
            (Ok(_), _) => (log, Ok(Feedback::default())),
            (Err(outcome), _) => (log, Err(outcome.clone())),
        };
        let (outcome, feedback) = match act_result {
            Ok(feedback) => (Outcome::Ok, feedback),
            Err(outcome) => (outcome, Feedback::default()),
        };
        let answer = result.ok().flatten();
        CompletedIteration {
            iteration: self.iteration,
            label: self.sample.label,
            log,
            outcome,
            answer,
            feedback,
            transport,
        }
    }
}
