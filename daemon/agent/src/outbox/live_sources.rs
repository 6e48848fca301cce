//! What live updates are made of.

use peernet_clock::WallTime;
use peernet_logger::HostId;
use peernet_stream::{Accounting, HostClock, HostMetrics, LiveUpdate};
use tokio::sync::watch;

use crate::link::Links;
use crate::live::{Board, Receipt};

/// Where the figures of a live update come from.
#[derive(Clone, Debug)]
pub(crate) struct LiveSources {
    pub(crate) board: Board,
    pub(crate) metrics: watch::Receiver<HostMetrics>,
    pub(crate) links: Links,
    /// What is known of this host's own clock.
    pub(crate) clock: watch::Receiver<HostClock>,
}

impl LiveSources {
    /// How everything is now. The receipt is given back to the board once the update was sent.
    pub(super) fn update(
        &self,
        host: HostId,
        sent: WallTime,
        accounting: Accounting,
    ) -> (LiveUpdate, Receipt) {
        let (pipelines, receipt) = self.board.look();
        let update = LiveUpdate {
            host,
            sent,
            pipelines,
            links: self.links.live(),
            clock: self.clock.borrow().clone(),
            metrics: self.metrics.borrow().clone(),
            accounting,
        };
        (update, receipt)
    }
}
