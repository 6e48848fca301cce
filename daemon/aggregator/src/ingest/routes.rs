//! Which host spoke on which connection.

use std::collections::HashMap;

use peernet_logger::HostId;
use peernet_networks::ConnectionId;

/// Hosts that may say hello on one connection: an agent needs one. There is no limit for all together: whoever
/// reached it would lock the others out, and the picture has one of its own.
const MOST_PER_CONNECTION: usize = 64;

/// What a connection may send from now on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// A host's hello was accepted on it.
    Admit(ConnectionId),
    /// It has no host any more.
    Demote(ConnectionId),
}

/// The connection on which each host said hello.
#[derive(Debug, Default)]
pub(super) struct Routes {
    connections: HashMap<HostId, ConnectionId>,
    /// What changed for connections and was not taken yet.
    admissions: Vec<Admission>,
}

impl Routes {
    /// The connection of a host.
    pub(super) fn of(&self, host: HostId) -> Option<ConnectionId> {
        self.connections.get(&host).copied()
    }

    /// All hosts that are here.
    pub(super) fn hosts(&self) -> impl Iterator<Item = HostId> {
        self.connections.keys().copied()
    }

    /// A host said hello on a connection.
    pub(super) fn enter(&mut self, host: HostId, connection: ConnectionId) {
        let left = self.connections.insert(host, connection);
        self.admissions.push(Admission::Admit(connection));
        self.demote(left);
    }

    /// A host is gone.
    pub(super) fn leave(&mut self, host: HostId) {
        let left = self.connections.remove(&host);
        self.demote(left);
    }

    /// All hosts are gone. Returns the connection of each.
    pub(super) fn clear(&mut self) -> Vec<ConnectionId> {
        let left: Vec<ConnectionId> = self.connections.drain().map(|(_, connection)| connection).collect();
        self.admissions.extend(left.iter().copied().map(Admission::Demote));
        left
    }

    /// What speaks against one more host.
    pub(super) fn too_many(&self, connection: ConnectionId, host: HostId) -> Option<String> {
        if self.connections.contains_key(&host) {
            return None;
        }
        let here = self.connections.values().filter(|other| **other == connection).count();
        (here >= MOST_PER_CONNECTION)
            .then(|| format!("{here} hosts said hello on this connection: let each agent open its own"))
    }

    /// Which connections have a host from now on, and which have none any more.
    pub(super) fn take_admissions(&mut self) -> Vec<Admission> {
        std::mem::take(&mut self.admissions)
    }

    /// Demotes a connection that a host left, unless there are others on it.
    fn demote(&mut self, left: Option<ConnectionId>) {
        let is_empty = |left: &ConnectionId| !self.connections.values().any(|other| other == left);
        self.admissions.extend(left.filter(is_empty).map(Admission::Demote));
    }
}
