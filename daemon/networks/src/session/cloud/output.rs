//! The sending half of a port.

use crate::session::completed_request::Sizes;
use crate::session::server::Admission;
use crate::statistics::{ConnectionStatistics, Counters};
use crate::transport::{CloudSender, ConnectionId, Frames, Peer, SendFailure, SendOptions};

/// Sends to the edges of a port, and counts what was sent and received on all connections together.
#[derive(Debug)]
pub(crate) struct ListenerOutput {
    sender: Box<dyn CloudSender>,
    pub(super) counters: Counters,
}

impl ListenerOutput {
    pub(super) fn new(sender: Box<dyn CloudSender>) -> Self {
        Self { sender, counters: Counters::default() }
    }

    /// Sets what the connection may send from now on.
    pub(super) fn set_admission(&self, connection: ConnectionId, admission: Admission) {
        match admission {
            Admission::Admitted => self.sender.admit(connection),
            Admission::Greeted => self.sender.greet(connection),
            Admission::Unadmitted => self.sender.demote(connection),
        }
    }

    /// Returns the statistics of a session, with the statistics of the connection from its transport.
    pub(super) fn statistics(
        &self,
        connection: ConnectionId,
        session_counters: &Counters,
    ) -> ConnectionStatistics {
        session_counters.statistics(&self.sender.statistics(connection))
    }

    /// Sends a message and counts it for the port and for its session.
    ///
    /// # Errors
    /// If the transport did not accept it.
    pub(super) fn send(
        &self,
        peer: &Peer,
        frames: Frames,
        tag: Option<u64>,
        session_counters: Option<&Counters>,
    ) -> Result<(), SendFailure> {
        let bytes = Sizes::from_frames(&frames).total();
        self.sender.send(peer, frames, SendOptions { deadline: None, tag })?;
        for counters in [Some(&self.counters), session_counters].into_iter().flatten() {
            counters.count_sent(bytes);
        }
        Ok(())
    }
}
