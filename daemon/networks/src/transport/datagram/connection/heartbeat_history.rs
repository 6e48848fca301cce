//! History of the other end's heartbeats.

use crate::transport::datagram::packet::Heartbeat;

/// Number of successive contradicting heartbeats at which the connection ends. The connection would not recover,
/// because the other end treats messages that are still to be sent as settled.
const MAX_CONTRADICTIONS: u32 = 3;

/// Detects duplicated heartbeats, and tells ends that disagree permanently from a single altered packet.
#[derive(Debug, Default)]
pub(super) struct HeartbeatHistory {
    last: Heartbeat,
    /// Number of successive heartbeats that contradict what was sent.
    contradictions: u32,
}

impl HeartbeatHistory {
    /// Handles a heartbeat. Returns whether it is new; the network may have duplicated the last one.
    pub(super) fn receive(&mut self, heartbeat: &Heartbeat) -> bool {
        std::mem::replace(&mut self.last, *heartbeat) != *heartbeat
    }

    /// Notes that the heartbeat agrees with what was sent.
    pub(super) fn agree(&mut self) {
        self.contradictions = 0;
    }

    /// Notes that the heartbeat contradicts what was sent. Returns whether too many successive ones do.
    pub(super) fn contradict(&mut self) -> bool {
        self.contradictions += 1;
        self.contradictions >= MAX_CONTRADICTIONS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_successive_contradictions_reach_limit() {
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
