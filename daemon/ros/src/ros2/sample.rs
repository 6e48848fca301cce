//! Received messages of ROS 2, and the counts of a subscription.

use bytes::Bytes;
use peernet_clock::WallTime;

use super::peers::EndpointId;

/// A received message.
#[derive(Clone, Debug)]
pub struct ReceivedSample {
    /// The encapsulation header and the message in CDR. Up to three bytes of padding may follow, because DDS sends
    /// multiples of four bytes.
    pub payload: Bytes,
    /// Time of publishing by the clock of the publisher's host; `None` if the publisher sent no time.
    pub source_time: Option<WallTime>,
    /// Time at which this host had received the whole message, by the operating system's clock.
    pub received_time: WallTime,
    /// The publisher.
    pub writer: EndpointId,
    /// Sequence number of the message at its publisher; the first message has 1.
    pub sequence: i64,
    /// Number of messages of the same publisher that are missing directly before this message.
    pub missing_before: u64,
}

/// Counts of a subscription since it was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReceiveCounts {
    /// Messages that were returned.
    pub received: u64,
    /// Messages of known publishers that never arrived, or that newer messages replaced before they were read.
    pub lost: u64,
    /// Messages that arrived after a message with a higher sequence number. They do not count as lost.
    pub late: u64,
    /// Messages of publishers with another message type, which are dropped.
    pub other_type: u64,
    /// Messages with an encoding other than plain CDR, which are dropped.
    pub undecodable: u64,
}
