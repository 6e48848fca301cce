//! Schema of the connections of a link.

use peernet_clock::Span;
use peernet_stream as stream;
use serde::Serialize;
use utoipa::ToSchema;

/// An open connection of a link. The counts are those of the edge; `cloud` has the counts of the cloud. All count from the opening of the
/// connection.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct LinkConnection {
    /// The pipeline that uses the connection.
    pub pipeline: String,
    /// Kind of network, such as `zmq-tcp`.
    pub network: String,
    /// The edge's address and port; null if the transport has none.
    pub local_address: Option<String>,
    /// The cloud's address and port.
    pub remote_address: Option<String>,
    /// The edge's network interface that the connection uses; null if unknown.
    pub interface: Option<LinkInterface>,
    /// Direction from edge to cloud.
    pub up: LinkDirection,
    /// Direction from cloud to edge.
    pub down: LinkDirection,
    /// The round trip of the transport's own packets; null if the transport does not measure one.
    pub transport_round_trip: Option<TransportRoundTrip>,
    /// Number of messages that arrived and could not be decoded.
    pub malformed_messages: u64,
    /// Number of answers that arrived after the timeout of their request.
    pub late_messages: u64,
    /// Number of requests that remain without an answer, because they or their answers were lost or the connection ended.
    pub lost_messages: u64,
    /// Counts of the cloud, one to two seconds old; null if the cloud reports none, as before release 0.3.
    pub cloud: Option<LinkCloudEnd>,
}

/// The cloud's end of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct LinkCloudEnd {
    /// Direction from edge to cloud.
    pub up: LinkDirection,
    /// Direction from cloud to edge.
    pub down: LinkDirection,
    /// The round trip of the transport's own packets; null if the transport does not measure one.
    pub transport_round_trip: Option<TransportRoundTrip>,
    /// Number of messages that arrived at the cloud and could not be decoded.
    pub malformed_messages: u64,
    /// Number of answers that could not be sent or were lost.
    pub lost_messages: u64,
}

/// A network interface of an edge.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct LinkInterface {
    pub name: String,
    /// `ethernet`, `wireless`, `loopback`, `tunnel`, or `type N` with a hardware type of Linux; null if the system does not report it.
    #[serde(rename = "type")]
    pub kind: Option<String>,
    pub mtu_bytes: Option<u32>,
}

/// One direction of a connection. Values that the counting host cannot know are null.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct LinkDirection {
    /// Bytes of the messages, without the overhead of the transport.
    pub bytes: u64,
    pub messages: u64,
    /// Number of datagrams with data, or for TCP of segments with data; a retransmission counts again.
    pub datagrams: Option<u64>,
    /// Number of datagrams that were sent and not received.
    pub lost_datagrams: Option<u64>,
    /// Number of datagrams that were received more than once.
    pub duplicated_datagrams: Option<u64>,
    /// Number of datagrams that were received out of order.
    pub reordered_datagrams: Option<u64>,
    /// Number of datagrams that were sent again.
    pub retransmitted_datagrams: Option<u64>,
}

/// Round trip of a transport's packets and their acknowledgements (RFC 6298), seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct TransportRoundTrip {
    /// Shortest recent round trip; null before the first measurement.
    pub min_s: Option<f64>,
    pub smoothed_s: f64,
    /// Smoothed mean deviation.
    pub variation_s: f64,
}

impl From<&stream::Connection> for LinkConnection {
    fn from(connection: &stream::Connection) -> Self {
        let statistics = &connection.statistics;
        Self {
            pipeline: connection.pipeline.to_string(),
            network: connection.network.to_string(),
            local_address: connection.local.clone(),
            remote_address: connection.remote.clone(),
            interface: connection.interface.as_ref().map(|interface| LinkInterface {
                name: interface.name.clone(),
                kind: interface.kind.clone(),
                mtu_bytes: interface.mtu_bytes,
            }),
            up: statistics.sent.into(),
            down: statistics.received.into(),
            transport_round_trip: statistics.round_trip.map(TransportRoundTrip::from),
            malformed_messages: statistics.malformed_messages,
            late_messages: statistics.late_messages,
            lost_messages: statistics.lost_messages,
            cloud: connection.cloud.as_ref().map(LinkCloudEnd::from),
        }
    }
}

impl From<&stream::ConnectionStatistics> for LinkCloudEnd {
    fn from(statistics: &stream::ConnectionStatistics) -> Self {
        Self {
            up: statistics.received.into(),
            down: statistics.sent.into(),
            transport_round_trip: statistics.round_trip.map(TransportRoundTrip::from),
            malformed_messages: statistics.malformed_messages,
            lost_messages: statistics.lost_messages,
        }
    }
}

impl From<stream::TransportRoundTrip> for TransportRoundTrip {
    fn from(trip: stream::TransportRoundTrip) -> Self {
        Self {
            min_s: trip.min.map(Span::seconds),
            smoothed_s: trip.smoothed.seconds(),
            variation_s: trip.variation.seconds(),
        }
    }
}

impl From<stream::DirectionStatistics> for LinkDirection {
    fn from(direction: stream::DirectionStatistics) -> Self {
        Self {
            bytes: direction.bytes,
            messages: direction.messages,
            datagrams: direction.datagrams,
            lost_datagrams: direction.lost,
            duplicated_datagrams: direction.duplicated,
            reordered_datagrams: direction.reordered,
            retransmitted_datagrams: direction.retransmitted,
        }
    }
}
