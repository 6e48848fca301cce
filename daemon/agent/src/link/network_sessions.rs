//! The networks that sessions of a link use.

use std::collections::BTreeMap;

use peernet_stream::NetworkName;

/// Closed seconds in which a network is still told of after its last session. Probes are those of the pair of hosts, sent by the oldest
/// session whatever its network: those that were under way when another session ended come back or are lost in this time.
const LINGER_SECONDS: u8 = 2;

/// Number of sessions by network. The last network stays for good: what follows its sessions is told of it.
#[derive(Debug, Default)]
pub(super) struct NetworkSessions(BTreeMap<NetworkName, Sessions>);

/// Sessions over one network.
#[derive(Debug, Default)]
struct Sessions {
    open: usize,
    /// Seconds that were closed since the last one was over.
    closed_seconds: u8,
}

impl NetworkSessions {
    /// A session over this network was opened.
    pub(super) fn join(&mut self, network: &NetworkName) {
        let sessions = self.0.entry(network.clone()).or_default();
        (sessions.open, sessions.closed_seconds) = (sessions.open + 1, 0);
    }

    /// A session over this network is over.
    pub(super) fn leave(&mut self, network: &NetworkName) {
        if let Some(sessions) = self.0.get_mut(network) {
            sessions.open = sessions.open.saturating_sub(1);
        }
    }

    /// A second was told of these networks.
    pub(super) fn close_second(&mut self) {
        for ended in self.0.values_mut().filter(|sessions| sessions.open == 0) {
            ended.closed_seconds = ended.closed_seconds.saturating_add(1);
        }
        self.take_ended(LINGER_SECONDS);
    }

    /// Takes away the networks without sessions of which so many seconds were told, unless none has any session.
    pub(super) fn take_ended(&mut self, closed_seconds: u8) -> Vec<NetworkName> {
        if self.0.values().all(|sessions| sessions.open == 0) {
            return Vec::new();
        }
        let is_ended = |sessions: &Sessions| sessions.open == 0 && sessions.closed_seconds >= closed_seconds;
        let ended = self.0.iter().filter(|(_, sessions)| is_ended(sessions));
        let ended: Vec<NetworkName> = ended.map(|(network, _)| network.clone()).collect();
        self.0.retain(|_, sessions| !is_ended(sessions));
        ended
    }

    /// The networks, in the order of their names.
    pub(super) fn names(&self) -> impl Iterator<Item = &NetworkName> {
        self.0.keys()
    }
}
