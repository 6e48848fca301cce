//! The networks that sessions of a link use.

use std::collections::BTreeMap;

use peernet_stream::NetworkName;

/// Number of sessions by network. The last network stays when its sessions are over: what follows them is told of it.
#[derive(Debug, Default)]
pub(super) struct NetworkSessions(BTreeMap<NetworkName, usize>);

impl NetworkSessions {
    /// A session over this network was opened.
    pub(super) fn join(&mut self, network: &NetworkName) {
        *self.0.entry(network.clone()).or_default() += 1;
    }

    /// A session over this network is over.
    pub(super) fn leave(&mut self, network: &NetworkName) {
        if let Some(sessions) = self.0.get_mut(network) {
            *sessions = sessions.saturating_sub(1);
        }
        if self.0.values().any(|sessions| *sessions > 0) {
            self.0.retain(|_, sessions| *sessions > 0);
        }
    }

    /// The networks, in the order of their names.
    pub(super) fn names(&self) -> impl Iterator<Item = &NetworkName> {
        self.0.keys()
    }
}
