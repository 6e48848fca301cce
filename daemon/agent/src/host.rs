//! This host, and where its parts report what happens.

use peernet_clock::SharedClock;
use peernet_logger::{HostId, Slug};

use crate::event_queue::EventQueue;
use crate::incidents::Incidents;
use crate::runs::Runs;

/// This host as it introduces itself.
#[derive(Clone, Debug)]
pub(crate) struct Host {
    pub(crate) id: HostId,
    pub(crate) name: Slug,
    /// The program's version, as peers and the aggregator are told.
    pub(crate) version: &'static str,
    pub(crate) clock: SharedClock,
}

/// Where parts of the agent report what happens.
#[derive(Clone, Debug)]
pub(crate) struct EventSinks {
    pub(crate) event_queue: EventQueue,
    pub(crate) incidents: Incidents,
    pub(crate) runs: Runs,
}
