//! The connections of a port, by number and by the hello that opened them, and the choice of the connection that is
//! closed for a new connection.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};

use super::entry::{Admission, Entry};
use crate::transport::AddressGroup;

/// Whether one more connection may be opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Capacity {
    Free,
    /// A further connection may be opened after this connection, which has no session, is closed.
    FreeAfterClosing(u64),
    Full,
}

/// All connections. Each is found by its number, and by the reply address and the nonce of its hello.
#[derive(Debug, Default)]
pub(super) struct ConnectionTable {
    entries: HashMap<u64, Entry>,
    by_nonce: HashMap<(SocketAddr, u64), u64>,
    /// Number of connections ever opened.
    opened_count: u64,
}

impl ConnectionTable {
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    /// Returns the number of connections ever opened.
    pub(super) const fn opened_count(&self) -> u64 {
        self.opened_count
    }

    pub(super) fn contains(&self, id: u64) -> bool {
        self.entries.contains_key(&id)
    }

    pub(super) fn get(&self, id: u64) -> Option<&Entry> {
        self.entries.get(&id)
    }

    pub(super) fn get_mut(&mut self, id: u64) -> Option<&mut Entry> {
        self.entries.get_mut(&id)
    }

    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = (u64, &mut Entry)> {
        self.entries.iter_mut().map(|(id, entry)| (*id, entry))
    }

    /// Returns the connection with this reply address and nonce.
    pub(super) fn find(&self, to: SocketAddr, nonce: u64) -> Option<u64> {
        self.by_nonce.get(&(to, nonce)).copied()
    }

    pub(super) fn insert(&mut self, id: u64, entry: Entry) {
        self.opened_count += 1;
        self.by_nonce.insert((entry.reply_address(), entry.nonce), id);
        self.entries.insert(id, entry);
    }

    pub(super) fn remove(&mut self, id: u64) {
        if let Some(entry) = self.entries.remove(&id) {
            self.by_nonce.remove(&(entry.reply_address(), entry.nonce));
        }
    }

    /// Changes the addresses of a connection: `source` is the new address of the other end, `local` the address of this
    /// machine at which its datagrams arrive.
    pub(super) fn relocate(&mut self, id: u64, source: SocketAddr, local: Option<IpAddr>) {
        if let Some(entry) = self.entries.get_mut(&id) {
            self.by_nonce.remove(&(entry.reply_address(), entry.nonce));
            (entry.source, entry.local) = (source, local);
            self.by_nonce.insert((entry.reply_address(), entry.nonce), id);
        }
    }

    /// Returns whether a peer from a group of addresses may open one more connection; `max` is the maximum number of
    /// connections.
    ///
    /// If a limit is reached, the oldest connection without a session must be closed first. If a limit per group is
    /// reached, that connection belongs to the same group. Otherwise that connection belongs to the group with the most
    /// connections without a session. One group therefore cannot keep the others out.
    pub(super) fn capacity(&self, group: AddressGroup, max: usize) -> Capacity {
        let max = max.max(1);
        // A closed connection remains in the table until its goodbye is sent. It does not count, and it is not closed
        // again: otherwise one closed connection would make room for all connections that are opened before then.
        let open_entries = || self.entries.iter().filter(|(_, entry)| !entry.connection.is_closed());
        // Number of connections of each group, and how many of them have no session.
        let mut groups: HashMap<AddressGroup, (usize, usize)> = HashMap::new();
        for (_, entry) in open_entries() {
            let (total, unadmitted) = groups.entry(AddressGroup::from_address(entry.source)).or_default();
            *total += 1;
            *unadmitted += usize::from(matches!(entry.admission, Admission::Unadmitted { .. }));
        }
        let (group_total, group_unadmitted) = groups.get(&group).copied().unwrap_or_default();
        let total: usize = groups.values().map(|(total, _)| total).sum();
        let unadmitted: usize = groups.values().map(|(_, unadmitted)| unadmitted).sum();
        // One group may have at most half of the connections, and at most a quarter without a session. Loopback is
        // exempt from the first limit, because all programs of this machine share the loopback address. At most
        // half of all connections may be without a session.
        let half = (max / 2).max(1);
        let replaced_group =
            if (!group.is_loopback() && group_total >= half) || group_unadmitted >= (max / 4).max(1) {
                group
            } else if total >= max || unadmitted >= half {
                let largest = groups.iter().max_by_key(|(_, (_, unadmitted))| *unadmitted);
                largest.map_or(group, |(group, _)| *group)
            } else {
                return Capacity::Free;
            };
        let oldest = open_entries()
            .filter(|(_, entry)| AddressGroup::from_address(entry.source) == replaced_group)
            .filter_map(|(id, entry)| match entry.admission {
                Admission::Unadmitted { since } => Some((since, *id)),
                // A connection whose request for a session is being decided is not closed.
                Admission::Greeted | Admission::Admitted => None,
            })
            .min();
        oldest.map_or(Capacity::Full, |(_, id)| Capacity::FreeAfterClosing(id))
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{MonoTime, Span};

    use super::*;
    use crate::transport::datagram::connection::Connection;
    use crate::transport::datagram::packet::{Role, Terms};
    use crate::transport::datagram::packet_writer::PacketWriter;
    use crate::transport::datagram::tests::limits;
    use crate::transport::memory::MemoryBudget;

    fn address(host: u8, port: u16) -> SocketAddr {
        SocketAddr::from(([198, 51, 100, host], port))
    }

    fn entry(source: SocketAddr, nonce: u64, admission: Admission) -> Entry {
        let limits = limits();
        let connection = Connection::new(
            PacketWriter::new(Role::Cloud, nonce, b""),
            Terms { window: 1 << 20, max_datagram_bytes: 1_200 },
            limits.connection,
            (limits.reassembly, MemoryBudget::new(1)),
            MonoTime::default(),
        );
        Entry::new(connection, (source, 0), None, nonce, 1_200, admission)
    }

    fn unadmitted(seconds: i64) -> Admission {
        Admission::Unadmitted { since: MonoTime::default() + Span::from_seconds(seconds) }
    }

    #[test]
    fn moved_connection_is_found_until_removed() {
        let mut table = ConnectionTable::default();
        table.insert(7, entry(address(1, 9), 3, Admission::Admitted));
        assert_eq!(table.find(address(1, 9), 3), Some(7));
        table.relocate(7, address(2, 8), None);
        assert_eq!((table.find(address(1, 9), 3), table.find(address(2, 8), 3)), (None, Some(7)));
        table.remove(7);
        assert_eq!((table.find(address(2, 8), 3), table.len(), table.opened_count()), (None, 0, 1));
    }

    #[test]
    fn oldest_connection_without_session_is_replaced() {
        let mut table = ConnectionTable::default();
        let (first_group, second_group) =
            (AddressGroup::from_address(address(1, 1)), AddressGroup::from_address(address(2, 1)));
        table.insert(1, entry(address(1, 1), 1, Admission::Admitted));
        assert_eq!(table.capacity(first_group, 8), Capacity::Free);
        table.insert(2, entry(address(1, 2), 2, unadmitted(5)));
        table.insert(3, entry(address(1, 3), 3, unadmitted(4)));
        assert_eq!(
            table.capacity(first_group, 8),
            Capacity::FreeAfterClosing(3),
            "a quarter of the connections comes from this group and has no session"
        );
        assert_eq!(table.capacity(second_group, 8), Capacity::Free);
        assert_eq!(
            table.capacity(second_group, 3),
            Capacity::FreeAfterClosing(3),
            "all connections are taken"
        );
        assert_eq!(table.capacity(first_group, 1_000), Capacity::Free);
    }

    #[test]
    fn closed_connection_makes_room_only_once() {
        let mut table = ConnectionTable::default();
        let group = AddressGroup::from_address(address(1, 1));
        for n in 1..=2 {
            table.insert(n, entry(address(1, n as u16), n, unadmitted(n as i64)));
        }
        for n in 1..=2 {
            assert_eq!(table.capacity(group, 8), Capacity::FreeAfterClosing(n));
            // The goodbyes are not sent yet, so the closed connections are still in the table.
            table.get_mut(n).expect("is there").connection.abandon();
            table.insert(n + 2, entry(address(1, n as u16 + 2), n + 2, unadmitted(n as i64 + 2)));
        }
        assert_eq!(table.capacity(group, 8), Capacity::FreeAfterClosing(3));
    }

    #[test]
    fn connections_with_sessions_are_not_replaced() {
        let mut table = ConnectionTable::default();
        for n in 1..=4 {
            table.insert(n, entry(address(n as u8, 1), n, Admission::Admitted));
        }
        assert_eq!(table.capacity(AddressGroup::from_address(address(9, 1)), 4), Capacity::Full);
    }
}
