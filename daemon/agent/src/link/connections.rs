//! The open connections of a link, for live updates.
//!
//! The outbox's thread reads the connections once a second, in less than 30 µs each. No sample waits for that. All
//! counts are totals since the connection was opened; readers compute rates.

use std::collections::BTreeMap;

use peernet_clock::{MonoTime, Span};
use peernet_networks::{ConnectionAddresses, outgoing_interface};
use peernet_stream::{Connection, NetworkInterface};

use super::shared::Session;

/// Age at which statistics are read again. Each reading queries the kernel, and live updates are more frequent.
const MAX_AGE: Span = Span::from_seconds(1);

/// Connections of a link, with the statistics that were last read.
#[derive(Debug, Default)]
pub(super) struct Connections {
    read_at: Option<MonoTime>,
    /// Addresses (`None` if unknown) and statistics by the number of the session.
    by_session: BTreeMap<u64, (Option<ConnectionAddresses>, Connection)>,
    /// `true` after a log line has said that the interfaces cannot be listed.
    has_logged_error: bool,
}

impl Connections {
    /// Returns the connections of these sessions, which are read again once a second. A session that has ended keeps
    /// its last statistics until it leaves the link.
    pub(super) fn read_for(&mut self, sessions: &[Session], now: MonoTime) -> Vec<Connection> {
        self.by_session.retain(|id, _| sessions.iter().any(|session| session.id == *id));
        let is_due = self.read_at.is_none_or(|at| now - at >= MAX_AGE);
        if is_due {
            self.read_at = Some(now);
        }
        for session in sessions {
            if is_due || !self.by_session.contains_key(&session.id) {
                self.read(session);
            }
        }
        self.by_session.values().map(|(_, connection)| connection.clone()).collect()
    }

    /// Reads the statistics of a session's connection. Keeps the last statistics if the session has ended.
    fn read(&mut self, session: &Session) {
        let Some(statistics) = session.statistics.read() else { return };
        let addresses = session.statistics.addresses();
        // The addresses may change: a connection over datagrams stays open when a host gets another address.
        let interface = match self.by_session.get(&session.id) {
            Some((previous, connection)) if *previous == addresses => connection.interface.clone(),
            _ => addresses.and_then(|addresses| self.find_interface(&addresses)),
        };
        let connection = Connection {
            pipeline: session.pipeline.clone(),
            network: session.network.clone(),
            local: addresses.map(|addresses| addresses.local.to_string()),
            remote: addresses.map(|addresses| addresses.remote.to_string()),
            interface,
            statistics,
            cloud: session.statistics.peer(),
        };
        self.by_session.insert(session.id, (addresses, connection));
    }

    /// Returns the network interface through which a connection sends; `None` if it cannot be determined.
    fn find_interface(&mut self, addresses: &ConnectionAddresses) -> Option<NetworkInterface> {
        outgoing_interface(addresses).unwrap_or_else(|error| {
            if !std::mem::replace(&mut self.has_logged_error, true) {
                let local = addresses.local;
                tracing::info!(%error, %local, "cannot list the network interfaces; the interfaces of connections are not shown");
            }
            None
        })
    }
}
