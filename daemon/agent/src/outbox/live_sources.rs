//! Sources of a live update.

use peernet_clock::WallTime;
use peernet_logger::HostId;
use peernet_networks::PeerClock;
use peernet_stream::{Accounting, HostMetrics, LiveUpdate};
use tokio::sync::watch;

use crate::host_clock;
use crate::link::Links;
use crate::live::{LiveStatistics, Receipt};

/// The parts of the agent whose state is in a live update.
#[derive(Clone, Debug)]
pub(crate) struct LiveSources {
    pub(crate) live_statistics: LiveStatistics,
    pub(crate) metrics: watch::Receiver<HostMetrics>,
    pub(crate) links: Links,
    /// State of this host's clocks.
    pub(crate) clock: watch::Receiver<PeerClock>,
}

impl LiveSources {
    /// Returns a live update of the current state. The caller passes the receipt to [`LiveStatistics::mark_sent`]
    /// after sending.
    pub(crate) fn update(
        &self,
        host: HostId,
        sent: WallTime,
        accounting: Accounting,
    ) -> (LiveUpdate, Receipt) {
        let (pipelines, receipt) = self.live_statistics.snapshot();
        let update = LiveUpdate {
            host,
            sent,
            pipelines,
            links: self.links.live(),
            clock: host_clock::describe_clock(&self.clock.borrow()),
            metrics: self.metrics.borrow().clone(),
            accounting,
        };
        (update, receipt)
    }
}
