//! Connections between an edge and a cloud: counts of sent and received data, and the network interface.

use peernet_clock::Span;
use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use crate::NetworkName;

/// A connection of a link, as counted by its edge and, if known, by its cloud.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Connection {
    /// Pipeline that uses the connection.
    pub pipeline: Slug,
    /// Kind of network, such as `zmq-tcp`.
    pub network: NetworkName,
    /// Address and port of the edge; `None` if the transport has none.
    pub local: Option<String>,
    /// Address and port of the cloud.
    pub remote: Option<String>,
    /// Interface of the edge that the connection uses; `None` if it is unknown.
    pub interface: Option<NetworkInterface>,
    /// Counts at the edge's end.
    pub statistics: ConnectionStatistics,
    /// Counts at the cloud's end, at most some seconds old; `None` if the cloud did not send them. Since version 7 of
    /// the event stream.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cloud: Option<ConnectionStatistics>,
}

/// A network interface of a host.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkInterface {
    /// Name, such as `eth0`.
    pub name: String,
    /// `ethernet`, `wireless`, `loopback`, `tunnel`, or `type N` with a hardware type of Linux (`ARPHRD_*`); `None` if
    /// the system does not state it.
    pub kind: Option<String>,
    /// Largest packet that the interface sends without fragmentation (maximum transmission unit), bytes.
    pub mtu_bytes: Option<u32>,
}

/// Totals of a connection since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConnectionStatistics {
    /// From this end to the peer.
    pub sent: DirectionStatistics,
    /// From the peer to this end.
    pub received: DirectionStatistics,
    /// Messages that arrived malformed and were dropped.
    pub malformed_messages: u64,
    /// Answers that arrived after the request had timed out.
    pub late_messages: u64,
    /// On the edge: requests that will never be answered, because the request or its answer was lost, or because the
    /// connection ended. On the cloud: answers that could not be handed to the network.
    pub lost_messages: u64,
    /// Round trip of the transport's own packets; `None` if the transport does not measure it.
    pub round_trip: Option<TransportRoundTrip>,
}

/// Totals of one direction of a connection. Counts that this end cannot know are `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DirectionStatistics {
    /// Bytes of the messages' frames, without the overhead of the transport.
    pub bytes: u64,
    /// Number of whole messages.
    pub messages: u64,
    /// Number of datagrams with data (for TCP, of segments with data), including retransmissions.
    pub datagrams: Option<u64>,
    /// Number of datagrams that were sent and did not arrive, or arrived too late to be recognised.
    pub lost: Option<u64>,
    /// Number of datagrams that arrived more than once.
    pub duplicated: Option<u64>,
    /// Number of datagrams that arrived out of order.
    pub reordered: Option<u64>,
    /// Number of datagrams that were retransmitted.
    pub retransmitted: Option<u64>,
}

/// Round trip of a transport's packets and their acknowledgements (RFC 6298).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransportRoundTrip {
    /// Shortest recent round trip; `None` before the first.
    pub min: Option<Span>,
    /// Smoothed round trip (`SRTT`).
    pub smoothed: Span,
    /// Smoothed mean deviation of the round trip (`RTTVAR`).
    pub variation: Span,
}
