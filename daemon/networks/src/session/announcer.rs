//! Telling edges what becomes known of the cloud's wall clock, and what was counted on their connections.

use std::sync::Weak;

use super::cloud::PortState;
use crate::PeerClock;

/// Tells the sessions of a [`Listener`](crate::Listener) what becomes known of the cloud's wall clock and of their connections. Clones tell
/// the same sessions; they do not keep the listener open.
#[derive(Clone, Debug)]
pub struct Announcer {
    shared: Weak<PortState>,
}

impl Announcer {
    pub(crate) const fn new(shared: Weak<PortState>) -> Self {
        Self { shared }
    }

    /// Tells all open sessions now, and those that open later in place of the
    /// [`host_clock`](crate::SessionAccepted::host_clock) that they are accepted with: no session misses it, however
    /// opening and telling fall together. Never waits; an edge whose connection takes no more is left out.
    pub fn announce(&self, clock: PeerClock) {
        if let Some(shared) = self.shared.upgrade() {
            shared.announce(clock);
        }
    }

    /// Tells each open session what was sent and received on its connection at this end. Asks the system about each
    /// connection, some 30 µs for one of TCP; never waits.
    pub fn report_statistics(&self) {
        if let Some(shared) = self.shared.upgrade() {
            shared.report_statistics();
        }
    }
}
