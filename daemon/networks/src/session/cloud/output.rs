//! The sending half of a port.

use crate::session::completed_request::MessageSizes;
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

    /// Tells the transport what the edge may send on the connection from now on.
    pub(super) fn set_admission(&self, connection: ConnectionId, admission: Admission) {
        match admission {
            Admission::Admitted => self.sender.admit(connection),
            Admission::Greeted => self.sender.note_hello(connection),
            Admission::Unadmitted => self.sender.demote(connection),
        }
    }

    /// Returns the statistics of a session: its own counters, and what the transport knows about the connection.
    pub(super) fn statistics(
        &self,
        connection: ConnectionId,
        session_counters: &Counters,
    ) -> ConnectionStatistics {
        session_counters.statistics(&self.sender.statistics(connection))
    }

    /// Sends a message and counts it for the port and for its session. `tag` is the number of the request that ends at
    /// the edge if the message is lost on the way.
    ///
    /// # Errors
    /// If the transport did not accept the message.
    pub(super) fn send(
        &self,
        peer: &Peer,
        frames: Frames,
        tag: Option<u64>,
        session_counters: Option<&Counters>,
    ) -> Result<(), SendFailure> {
        let bytes = MessageSizes::from_frames(&frames).total();
        self.sender.send(peer, frames, SendOptions { deadline: None, tag })?;
        for counters in [Some(&self.counters), session_counters].into_iter().flatten() {
            counters.count_sent(bytes);
        }
        Ok(())
    }
}
