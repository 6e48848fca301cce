//! An iteration from the moment its sample is ready to the moment its answer is acted upon.

use std::time::Duration;

use peernet_clock::{MonoTime, Span};
use peernet_logger::{NodeId, Recorder, stage};
use peernet_sample::Sample;
use peernet_stream::Outcome;

use super::acting::Acting;
use super::load::Start;
use super::placement::{Computed, Placement};
use super::progress::Position;

/// What identifies an iteration under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ticket {
    pub(super) position: Position,
    pub(super) start: Start,
    /// When it really began.
    pub(super) begun: MonoTime,
}

/// A sample that waits for a free place in flight.
pub(super) struct Waiting {
    pub(super) ticket: Ticket,
    pub(super) log: Recorder,
    pub(super) sample: Sample,
    /// The node `send-queue`, where waiting is possible at all.
    pub(super) queued: Option<NodeId>,
}

/// An iteration whose answer is there, or will never be.
pub(super) struct Landed {
    pub(super) ticket: Ticket,
    /// The right answer, where the data set knows it.
    pub(super) label: Option<String>,
    pub(super) log: Recorder,
    pub(super) outcome: Outcome,
    /// What was answered and acted upon, where there was an answer.
    pub(super) answer: Option<Sample>,
    /// The way there and the way back together, where it is known.
    pub(super) transport: Option<Span>,
}

impl Waiting {
    /// A sample that became ready now. In a closed loop nothing ever waits, and nothing is recorded.
    pub(super) fn new(ticket: Ticket, mut log: Recorder, sample: Sample, closed_loop: bool) -> Self {
        let queued = (!closed_loop).then(|| log.start(stage::SEND_QUEUE));
        Self { ticket, log, sample, queued }
    }

    /// There is a place: computes, and acts upon the answer.
    pub(super) async fn fly(
        mut self,
        placement: &Placement,
        timeout: Duration,
        acting: Option<Acting>,
    ) -> Landed {
        if let Some(queued) = self.queued {
            self.log.stop(queued);
        }
        let Computed { log, result, transport } = placement.compute(self.log, &self.sample, timeout).await;
        let (log, outcome) = match (&result, acting) {
            (Ok(Some(answer)), Some(acting)) => {
                let (log, acted) = acting.act(log, &self.sample.source, answer).await;
                (log, acted.map_or_else(|error| Outcome::Failed(error.to_string()), |()| Outcome::Ok))
            }
            (Ok(_), _) => (log, Outcome::Ok),
            (Err(outcome), _) => (log, outcome.clone()),
        };
        let answer = result.ok().flatten();
        Landed { ticket: self.ticket, label: self.sample.label, log, outcome, answer, transport }
    }
}
