//! An iteration from the moment its sample is ready to the moment its answer is there.

use std::time::Duration;

use peernet_clock::MonoTime;
use peernet_logger::{NodeId, Recorder, stage};
use peernet_sample::Sample;

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
    /// Where the sample came from.
    pub(super) source: String,
    pub(super) computed: Computed,
}

impl Waiting {
    /// A sample that became ready now. In a closed loop nothing ever waits, and nothing is recorded.
    pub(super) fn new(ticket: Ticket, mut log: Recorder, sample: Sample, closed_loop: bool) -> Self {
        let queued = (!closed_loop).then(|| log.start(stage::SEND_QUEUE));
        Self { ticket, log, sample, queued }
    }

    /// There is a place.
    pub(super) async fn fly(mut self, placement: &Placement, timeout: Duration) -> Landed {
        if let Some(queued) = self.queued {
            self.log.stop(queued);
        }
        let computed = placement.compute(self.log, &self.sample, timeout).await;
        Landed { ticket: self.ticket, source: self.sample.source, computed }
    }
}
