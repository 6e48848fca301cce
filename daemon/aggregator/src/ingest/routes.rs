//! The connection of each host with a session.

use std::collections::HashMap;

use peernet_logger::HostId;
use peernet_networks::ConnectionId;

/// Maximum number of hosts on one connection; an agent has one host. The hosts of all connections together are not
/// limited here: somebody who reached that limit would lock out all other agents, and the live state has a limit for
/// hosts.
const MAX_HOSTS_PER_CONNECTION: usize = 64;

/// A change of how much a connection may send: an admitted connection may send large messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// A host's hello was accepted on the connection.
    Admit(ConnectionId),
    /// The connection has no host any more. The next hello must arrive in time, as on a new connection.
    Demote(ConnectionId),
}

/// The connection on which each host sent its hello.
#[derive(Debug, Default)]
pub(super) struct Routes {
    connections: HashMap<HostId, ConnectionId>,
    /// Changes that the ingest task has not collected yet.
    admissions: Vec<Admission>,
}

impl Routes {
    /// Returns the connection of a host.
    pub(super) fn connection_of(&self, host: HostId) -> Option<ConnectionId> {
        self.connections.get(&host).copied()
    }

    /// Returns all hosts with a connection.
    pub(super) fn hosts(&self) -> impl Iterator<Item = HostId> {
        self.connections.keys().copied()
    }

    /// Records that a host's hello was accepted on a connection.
    pub(super) fn insert(&mut self, host: HostId, connection: ConnectionId) {
        // The host may have opened a new connection before the loss of the old connection was noticed.
        let former = self.connections.insert(host, connection);
        self.admissions.push(Admission::Admit(connection));
        self.demote(former);
    }

    /// Removes a host.
    pub(super) fn remove(&mut self, host: HostId) {
        let former = self.connections.remove(&host);
        self.demote(former);
    }

    /// Removes all hosts. Returns the connection of each.
    pub(super) fn clear(&mut self) -> Vec<ConnectionId> {
        let former: Vec<ConnectionId> = self.connections.drain().map(|(_, connection)| connection).collect();
        self.admissions.extend(former.iter().copied().map(Admission::Demote));
        former
    }

    /// Returns the reason for refusing a further host on this connection, if the connection has too many hosts.
    pub(super) fn limit_refusal(&self, connection: ConnectionId, host: HostId) -> Option<String> {
        if self.connections.contains_key(&host) {
            return None;
        }
        let hosts_of_connection = self.connections.values().filter(|other| **other == connection).count();
        (hosts_of_connection >= MAX_HOSTS_PER_CONNECTION).then(|| {
            format!("{hosts_of_connection} hosts have sent a hello on this connection; let each agent open its own connection")
        })
    }

    /// Returns and clears the changes that were not collected yet.
    pub(super) fn take_admissions(&mut self) -> Vec<Admission> {
        std::mem::take(&mut self.admissions)
    }

    /// Demotes a connection that a host left, unless other hosts use it.
    fn demote(&mut self, former: Option<ConnectionId>) {
        let has_no_host = |former: &ConnectionId| !self.connections.values().any(|other| other == former);
        self.admissions.extend(former.filter(has_no_host).map(Admission::Demote));
    }
}
