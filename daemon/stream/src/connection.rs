//! Connections between an edge and a cloud: what was sent and received on them, and over which interface.

use peernet_clock::Span;
use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use crate::NetworkName;

/// A connection of a link, by the account of its edge and, where that is known, of its cloud.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Connection {
    /// The pipeline that uses it.
    pub pipeline: Slug,
    /// Kind of network, such as `zmq-tcp`.
    pub network: NetworkName,
    /// The edge's address and port; `None` where the transport has none.
    pub local: Option<String>,
    /// The cloud's address and port.
    pub remote: Option<String>,
    /// The interface of the edge that it leaves by; `None` where it is not known.
    pub interface: Option<NetworkInterface>,
    /// What was sent and received on it.
    pub statistics: ConnectionStatistics,
    /// What the cloud counted at its end, some seconds ago at most; `None` where it did not tell. Since version 7 of the event
    /// stream.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cloud: Option<ConnectionStatistics>,
}

/// An interface of a host.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkInterface {
    /// Such as `eth0`.
    pub name: String,
    /// `ethernet`, `wireless`, `loopback`, `tunnel`, or `type N` with a hardware type of Linux (`ARPHRD_*`); `None` where
    /// the system does not tell.
    pub kind: Option<String>,
    /// The largest packet that it sends in one piece, bytes.
    pub mtu_bytes: Option<u32>,
}

/// Totals of a connection since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConnectionStatistics {
    /// From this end to the peer.
    pub sent: DirectionStatistics,
    /// From the peer to this end.
    pub received: DirectionStatistics,
    /// Messages that arrived and made no sense; they were dropped.
    pub malformed_messages: u64,
    /// Answers that arrived after the request had been given up.
    pub late_messages: u64,
    /// On the edge requests that will never be answered, because they or their answers were lost on the way or the
    /// connection ended. On the cloud answers that could not
    /// be handed to the network.
    pub lost_messages: u64,
    /// The round trip of the transport's own packets; `None` where the transport does not measure one.
    pub round_trip: Option<TransportRoundTrip>,
}

/// Totals of one direction of a connection. What this end cannot know of a direction is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DirectionStatistics {
    /// Bytes of the messages' frames, without what the transport adds around them.
    pub bytes: u64,
    /// Whole messages.
    pub messages: u64,
    /// Datagrams with data, with TCP segments with data; those sent again count again.
    pub datagrams: Option<u64>,
    /// Datagrams that were sent and did not arrive, or too late to tell.
    pub lost: Option<u64>,
    /// Datagrams that arrived more than once.
    pub duplicated: Option<u64>,
    /// Datagrams that arrived out of order.
    pub reordered: Option<u64>,
    /// Datagrams that were sent again.
    pub retransmitted: Option<u64>,
}

/// Round trip of a transport's packets and their acknowledgements (RFC 6298).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransportRoundTrip {
    /// The shortest lately; `None` before the first.
    pub min: Option<Span>,
    /// The smoothed round trip, `SRTT`.
    pub smoothed: Span,
    /// Its smoothed mean deviation, `RTTVAR`.
    pub variation: Span,
}
