//! The networks that sessions of a link use.

use std::collections::BTreeMap;

use peernet_stream::NetworkName;

/// Number of closed seconds for which a network still gets clock samples after its last session has ended.
// The oldest session of the link sends all probes, and the samples of each network count these probes. Within this time
// most of the probes that were in flight at the end of the network's last session are answered or lost.
const LINGER_SECONDS: u8 = 2;

/// Sessions by network. The network of the last session is not removed, so that later clock samples have a network.
#[derive(Debug, Default)]
pub(super) struct NetworkSessions(BTreeMap<NetworkName, Sessions>);

/// Sessions over one network.
#[derive(Debug, Default)]
struct Sessions {
    open_sessions: usize,
    /// Number of seconds closed since the last session ended.
    closed_seconds: u8,
}

impl NetworkSessions {
    /// Records that a session over this network was opened.
    pub(super) fn join(&mut self, network: &NetworkName) {
        let sessions = self.0.entry(network.clone()).or_default();
        (sessions.open_sessions, sessions.closed_seconds) = (sessions.open_sessions + 1, 0);
    }

    /// Records that a session over this network has ended.
    pub(super) fn leave(&mut self, network: &NetworkName) {
        if let Some(sessions) = self.0.get_mut(network) {
            sessions.open_sessions = sessions.open_sessions.saturating_sub(1);
        }
    }

    /// Records that a second was closed for these networks.
    pub(super) fn close_second(&mut self) {
        for sessions in self.0.values_mut().filter(|sessions| sessions.open_sessions == 0) {
            sessions.closed_seconds = sessions.closed_seconds.saturating_add(1);
        }
        self.take_ended(LINGER_SECONDS);
    }

    /// Removes and returns the networks without sessions for which at least `closed_seconds` seconds were closed since
    /// their last session. If no network has a session, none is removed.
    pub(super) fn take_ended(&mut self, closed_seconds: u8) -> Vec<NetworkName> {
        if self.0.values().all(|sessions| sessions.open_sessions == 0) {
            return Vec::new();
        }
        let is_ended =
            |sessions: &Sessions| sessions.open_sessions == 0 && sessions.closed_seconds >= closed_seconds;
        let ended_networks = self.0.iter().filter(|(_, sessions)| is_ended(sessions));
        let ended_networks: Vec<NetworkName> = ended_networks.map(|(network, _)| network.clone()).collect();
        self.0.retain(|_, sessions| !is_ended(sessions));
        ended_networks
    }

    /// Returns the networks in the order of their names.
    pub(super) fn names(&self) -> impl Iterator<Item = &NetworkName> {
        self.0.keys()
    }
}
