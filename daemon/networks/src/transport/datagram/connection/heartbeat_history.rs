//! The other end's heartbeats, in succession.

use crate::transport::datagram::packet::Heartbeat;

/// Heartbeats in succession that contradict what was sent, at which the connection ends. It would not recover: the other
/// end takes messages that are still to be sent for settled.
const MAX_CONTRADICTIONS: u32 = 3;

/// Tells doubled heartbeats from new ones, and ends that have lost touch from a single packet that was altered.
#[derive(Debug, Default)]
pub(super) struct HeartbeatHistory {
    last: Heartbeat,
    /// Heartbeats in succession that contradict what was sent.
    contradictions: u32,
}

impl HeartbeatHistory {
    /// A heartbeat arrived. Returns whether it is a new one: the network may have doubled the last.
    pub(super) fn receive(&mut self, heartbeat: &Heartbeat) -> bool {
        std::mem::replace(&mut self.last, *heartbeat) != *heartbeat
    }

    /// The heartbeat agrees with what was sent.
    pub(super) fn agree(&mut self) {
        self.contradictions = 0;
    }

    /// The heartbeat contradicts what was sent. Returns whether too many in succession do.
    pub(super) fn contradict(&mut self) -> bool {
        self.contradictions += 1;
        self.contradictions >= MAX_CONTRADICTIONS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_contradictions_in_succession_are_too_many() {
        let mut heartbeats = HeartbeatHistory::default();
        assert!(!heartbeats.contradict() && !heartbeats.contradict());
        heartbeats.agree();
        assert!(!heartbeats.contradict() && !heartbeats.contradict() && heartbeats.contradict());
    }

    #[test]
    fn doubled_heartbeat_is_not_new() {
        let (mut heartbeats, heartbeat) =
            (HeartbeatHistory::default(), Heartbeat { time: 1, ..Heartbeat::default() });
        assert!(heartbeats.receive(&heartbeat) && !heartbeats.receive(&heartbeat));
        assert!(heartbeats.receive(&Heartbeat { time: 2, ..heartbeat }));
    }
}
