//! The open connections of a listener, and the choice of the connection that is closed for a new connection.

use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::connection::{Phase, ZmtpConnection};
use super::limits::ListenerLimits;
use super::rejections::Rejection;
use crate::transport::{AddressGroup, ConnectionId};

/// All open connections.
#[derive(Debug)]
pub(super) struct ConnectionTable {
    limits: ListenerLimits,
    entries: Mutex<Entries>,
}

#[derive(Debug, Default)]
struct Entries {
    last_id: u64,
    /// All open connections by id.
    connections: HashMap<ConnectionId, Arc<ZmtpConnection>>,
    /// Connections that are not admitted, oldest first, because ids increase.
    unadmitted: BTreeSet<ConnectionId>,
    /// Number of connections of each address.
    groups: HashMap<AddressGroup, ConnectionCount>,
}

/// Number of connections of one address.
#[derive(Clone, Copy, Debug, Default)]
struct ConnectionCount {
    total: usize,
    unadmitted: usize,
}

impl ConnectionTable {
    pub(super) fn new(limits: ListenerLimits) -> Self {
        Self { limits, entries: Mutex::default() }
    }

    fn entries(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn get(&self, id: ConnectionId) -> Option<Arc<ZmtpConnection>> {
        self.entries().connections.get(&id).cloned()
    }

    pub(super) fn connections(&self) -> Vec<Arc<ZmtpConnection>> {
        self.entries().connections.values().cloned().collect()
    }

    /// Adds a new connection. If a limit is reached, removes the oldest connection that is not admitted: at a limit per
    /// address, the oldest of the new connection's address; at another limit, the oldest of the address with the most
    /// connections that are not admitted.
    ///
    /// # Errors
    /// If all connections that could make room are admitted.
    pub(super) fn insert(
        &self,
        group: AddressGroup,
        new_connection: impl FnOnce(ConnectionId) -> Arc<ZmtpConnection>,
    ) -> Result<InsertedConnection, Rejection> {
        let mut entries = self.entries();
        let mut replaced = Vec::new();
        let group_count = entries.groups.get(&group).copied().unwrap_or_default();
        // All programs of this machine share the loopback address.
        let is_group_full = !group.is_loopback() && group_count.total >= self.limits.max_per_address();
        if is_group_full || group_count.unadmitted >= self.limits.max_unadmitted_per_address() {
            let oldest = entries.oldest_unadmitted(group).ok_or(Rejection::TooManyOfAddress)?;
            replaced.extend(entries.remove(oldest));
        } else if entries.connections.len() >= self.limits.max_connections
            || entries.unadmitted.len() >= self.limits.max_unadmitted()
        {
            let fullest_group =
                entries.groups.iter().max_by_key(|(_, count)| count.unadmitted).map(|(group, _)| *group);
            let oldest =
                fullest_group.and_then(|group| entries.oldest_unadmitted(group)).ok_or(Rejection::TooMany)?;
            replaced.extend(entries.remove(oldest));
        }
        entries.last_id += 1;
        let id = ConnectionId(entries.last_id);
        let connection = new_connection(id);
        entries.connections.insert(id, Arc::clone(&connection));
        entries.unadmitted.insert(id);
        let count = entries.groups.entry(group).or_default();
        count.total += 1;
        count.unadmitted += 1;
        Ok(InsertedConnection { connection, replaced })
    }

    /// Notes that the hello of a connection is being decided. The hello timeout does not apply meanwhile.
    pub(super) fn note_hello(&self, id: ConnectionId) {
        if let Some(connection) = self.get(id) {
            connection.advance(Phase::Greeted);
        }
    }

    pub(super) fn admit(&self, id: ConnectionId) {
        self.set_phase(id, Phase::Admitted);
    }

    /// Notes that the session or host that admitted the connection is gone. The next hello must arrive in time.
    pub(super) fn demote(&self, id: ConnectionId) {
        self.set_phase(id, Phase::Unadmitted);
    }

    fn set_phase(&self, id: ConnectionId, phase: Phase) {
        let mut entries = self.entries();
        let Some(connection) = entries.connections.get(&id).cloned() else { return };
        connection.advance(phase);
        let is_admitted = phase == Phase::Admitted;
        let changed =
            if is_admitted { entries.unadmitted.remove(&id) } else { entries.unadmitted.insert(id) };
        if changed && let Some(count) = entries.groups.get_mut(&connection.group) {
            count.unadmitted = if is_admitted { count.unadmitted - 1 } else { count.unadmitted + 1 };
        }
    }

    pub(super) fn remove(&self, id: ConnectionId) {
        self.entries().remove(id);
    }
}

/// A connection that was added, and the connections that were removed for it. The caller must close the removed
/// connections.
#[derive(Debug)]
pub(super) struct InsertedConnection {
    pub(super) connection: Arc<ZmtpConnection>,
    pub(super) replaced: Vec<Arc<ZmtpConnection>>,
}

impl Entries {
    fn oldest_unadmitted(&self, group: AddressGroup) -> Option<ConnectionId> {
        self.unadmitted
            .iter()
            .copied()
            .find(|id| self.connections.get(id).is_some_and(|connection| connection.group == group))
    }

    fn remove(&mut self, id: ConnectionId) -> Option<Arc<ZmtpConnection>> {
        let connection = self.connections.remove(&id)?;
        let was_unadmitted = self.unadmitted.remove(&id);
        if let Some(count) = self.groups.get_mut(&connection.group) {
            count.total -= 1;
            count.unadmitted -= usize::from(was_unadmitted);
            if count.total == 0 {
                self.groups.remove(&connection.group);
            }
        }
        Some(connection)
    }
}
