//! The networks that sessions of a link use.

use std::collections::BTreeMap;

use peernet_stream::NetworkName;

/// Number of sessions by network. A network whose sessions are over stays until everything of them is counted and the second in which that
/// happened is closed; the last network stays for good, because what follows its sessions is told of it.
#[derive(Debug, Default)]
pub(super) struct NetworkSessions(BTreeMap<NetworkName, Sessions>);

/// Sessions over one network.
#[derive(Debug, Default)]
struct Sessions {
    open: usize,
    /// Everything of those that are over is counted.
    is_settled: bool,
}

impl NetworkSessions {
    /// A session over this network was opened.
    pub(super) fn join(&mut self, network: &NetworkName) {
        let sessions = self.0.entry(network.clone()).or_default();
        (sessions.open, sessions.is_settled) = (sessions.open + 1, false);
    }

    /// A session over this network is over.
    pub(super) fn leave(&mut self, network: &NetworkName) {
        if let Some(sessions) = self.0.get_mut(network) {
            sessions.open = sessions.open.saturating_sub(1);
        }
    }

    /// Everything of the sessions that are over by now is counted.
    pub(super) fn settle(&mut self) {
        self.0.values_mut().for_each(|sessions| sessions.is_settled = sessions.open == 0);
    }

    /// Forgets the networks whose sessions are over and counted.
    pub(super) fn close_second(&mut self) {
        if self.0.values().any(|sessions| sessions.open > 0) {
            self.0.retain(|_, sessions| !sessions.is_settled);
        }
    }

    /// The networks, in the order of their names.
    pub(super) fn names(&self) -> impl Iterator<Item = &NetworkName> {
        self.0.keys()
    }
}
