//! Messages as they are received, and what is counted about them.

use bytes::Bytes;
use peernet_clock::WallTime;

use super::peers::EndpointId;

/// A received message.
#[derive(Clone, Debug)]
pub struct ReceivedSample {
    /// The encapsulation header and the message in CDR; up to three bytes of padding may follow, because DDS sends
    /// multiples of four bytes.
    pub payload: Bytes,
    /// When the publisher published the message, by the clock of the publisher's host; `None` where it sent no time.
    pub source_time: Option<WallTime>,
    /// When this host had received the whole message, by the operating system's clock.
    pub received_time: WallTime,
    /// The publisher.
    pub writer: EndpointId,
    /// The publisher's sequence number of the message; the first has 1.
    pub sequence: i64,
    /// Messages of the same publisher that are missing directly before this one.
    pub missing_before: u64,
}

/// What a subscription has counted since it exists.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReceiveCounts {
    /// Messages that were handed over.
    pub received: u64,
    /// Messages of known publishers that never arrived, or that newer ones replaced before they were read.
    pub lost: u64,
    /// Messages that came after one with a higher sequence number; they do not count as lost.
    pub late: u64,
    /// Messages of publishers whose message type is another one; they are not handed over.
    pub other_type: u64,
    /// Messages whose encoding is not plain CDR; they are not handed over.
    pub undecodable: u64,
}
