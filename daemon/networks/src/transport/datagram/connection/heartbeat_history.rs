//! History of the other end's heartbeats.

use crate::transport::datagram::packet::Heartbeat;

/// The connection ends after this number of successive heartbeats that contradict what this end has sent.
// The connection would not recover, because the other end treats messages as settled that this end has not sent yet.
const MAX_CONTRADICTIONS: u32 = 3;

/// Detects duplicated heartbeats, and distinguishes ends that disagree permanently from a single altered packet.
#[derive(Debug, Default)]
pub(super) struct HeartbeatHistory {
    last: Heartbeat,
    /// Number of successive heartbeats that contradict what this end has sent.
    contradictions: u32,
}

impl HeartbeatHistory {
    /// Stores a heartbeat. Returns `false` if the heartbeat equals the last one: the network has duplicated the packet.
    pub(super) fn record_if_new(&mut self, heartbeat: &Heartbeat) -> bool {
        std::mem::replace(&mut self.last, *heartbeat) != *heartbeat
    }

    /// Notes that the heartbeat agrees with what this end has sent.
    pub(super) fn record_agreement(&mut self) {
        self.contradictions = 0;
    }

    /// Notes that the heartbeat contradicts what this end has sent. Returns whether too many successive heartbeats did
    /// so.
    pub(super) fn record_contradiction(&mut self) -> bool {
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
        assert!(!heartbeats.record_contradiction() && !heartbeats.record_contradiction());
        heartbeats.record_agreement();
        assert!(
            !heartbeats.record_contradiction()
                && !heartbeats.record_contradiction()
                && heartbeats.record_contradiction()
        );
    }

    #[test]
    fn duplicated_heartbeat_is_not_new() {
        let (mut heartbeats, heartbeat) =
            (HeartbeatHistory::default(), Heartbeat { time: 1, ..Heartbeat::default() });
        assert!(heartbeats.record_if_new(&heartbeat) && !heartbeats.record_if_new(&heartbeat));
        assert!(heartbeats.record_if_new(&Heartbeat { time: 2, ..heartbeat }));
    }
}
