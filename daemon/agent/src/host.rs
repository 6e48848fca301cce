//! This host's identity, and the objects to which the agent's parts report.

use peernet_clock::SharedClock;
use peernet_logger::{HostId, Slug};

use crate::event_queue::EventQueue;
use crate::incidents::Incidents;
use crate::runs::Runs;

/// This host: identity, version and clock.
#[derive(Clone, Debug)]
pub(crate) struct Host {
    pub(crate) id: HostId,
    pub(crate) name: Slug,
    /// Version of the program, as sent to peers and the aggregator.
    pub(crate) version: &'static str,
    pub(crate) clock: SharedClock,
}

/// The objects to which parts of the agent report events, incidents, and the starts and ends of runs.
#[derive(Clone, Debug)]
pub(crate) struct EventSinks {
    pub(crate) event_queue: EventQueue,
    pub(crate) incidents: Incidents,
    pub(crate) runs: Runs,
}
