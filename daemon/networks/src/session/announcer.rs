//! Sends clock states and statistics of the cloud to edges.

use std::sync::Weak;

use super::cloud::ListenerState;
use crate::PeerClock;

/// Sends clock states and statistics to the sessions of a [`Listener`](crate::Listener). Clones belong to the same
/// listener and do not keep it open.
#[derive(Clone, Debug)]
pub struct Announcer {
    shared: Weak<ListenerState>,
}

impl Announcer {
    pub(crate) const fn new(shared: Weak<ListenerState>) -> Self {
        Self { shared }
    }

    /// Sends the state of the cloud's clocks to all open sessions.
    ///
    /// A session that is accepted later also gets this state. It replaces
    /// [`host_clock`](crate::SessionAccepted::host_clock), because the caller of
    /// [`accept`](crate::OpenRequest::accept) may have read that value before this announcement.
    ///
    /// Never waits. An open session whose connection takes no more bytes does not get this state.
    pub fn announce(&self, clock: PeerClock) {
        if let Some(shared) = self.shared.upgrade() {
            shared.send_clock_to_edges(clock);
        }
    }

    /// Sends to the edge of each open session the statistics of the cloud's end of the connection. Never waits. Queries
    /// the system about each connection, which takes about 30 µs for TCP.
    pub fn report_statistics(&self) {
        if let Some(shared) = self.shared.upgrade() {
            shared.report_statistics();
        }
    }
}
