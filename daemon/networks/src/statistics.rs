//! Counters of the messages of a connection or a listener, and the statistics made of them.
//!
//! Messages and their bytes are counted alike for every transport. Datagrams, losses, duplicates, reordering,
//! retransmissions and round trips come from the transport. All values are totals since the connection was opened or
//! the port was bound; readers compute rates from them.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};

pub use peernet_stream::{ConnectionStatistics, DirectionStatistics, TransportRoundTrip};

/// Totals of messages and bytes, counted in the same way for every transport and from any thread.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    sent_messages: AtomicU64,
    sent_bytes: AtomicU64,
    received_messages: AtomicU64,
    received_bytes: AtomicU64,
    malformed_messages: AtomicU64,
    late_messages: AtomicU64,
    lost_messages: AtomicU64,
}

/// Statistics that only the transport knows: totals since the connection was opened. A value that the transport does
/// not know is `None`, never 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TransportStatistics {
    pub(crate) sent: DatagramStatistics,
    pub(crate) received: DatagramStatistics,
    pub(crate) round_trip: Option<TransportRoundTrip>,
}

/// Datagrams of one direction, as in [`DirectionStatistics`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DatagramStatistics {
    pub(crate) datagrams: Option<u64>,
    pub(crate) lost: Option<u64>,
    pub(crate) duplicated: Option<u64>,
    pub(crate) reordered: Option<u64>,
    pub(crate) retransmitted: Option<u64>,
}

/// Addresses of the two ends of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConnectionAddresses {
    /// Address of this end.
    pub local: SocketAddr,
    /// Address of the peer.
    pub remote: SocketAddr,
}

impl Counters {
    pub(crate) fn count_sent(&self, bytes: u64) {
        // Relaxed is enough here and below, because no reader relates two totals to each other.
        self.sent_messages.fetch_add(1, Ordering::Relaxed);
        self.sent_bytes.fetch_add(bytes, Ordering::Relaxed);
    }

    pub(crate) fn count_received(&self, bytes: u64) {
        self.received_messages.fetch_add(1, Ordering::Relaxed);
        self.received_bytes.fetch_add(bytes, Ordering::Relaxed);
    }

    pub(crate) fn count_malformed(&self) {
        self.malformed_messages.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn count_late(&self) {
        self.late_messages.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn count_lost(&self, count: u64) {
        self.lost_messages.fetch_add(count, Ordering::Relaxed);
    }

    /// Returns the totals together with the totals of the transport.
    pub(crate) fn statistics(&self, transport: &TransportStatistics) -> ConnectionStatistics {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        ConnectionStatistics {
            sent: direction_statistics(read(&self.sent_messages), read(&self.sent_bytes), transport.sent),
            received: direction_statistics(
                read(&self.received_messages),
                read(&self.received_bytes),
                transport.received,
            ),
            malformed_messages: read(&self.malformed_messages),
            late_messages: read(&self.late_messages),
            lost_messages: read(&self.lost_messages),
            round_trip: transport.round_trip,
        }
    }
}

const fn direction_statistics(
    messages: u64,
    bytes: u64,
    transport: DatagramStatistics,
) -> DirectionStatistics {
    let DatagramStatistics { datagrams, lost, duplicated, reordered, retransmitted } = transport;
    DirectionStatistics { bytes, messages, datagrams, lost, duplicated, reordered, retransmitted }
}
