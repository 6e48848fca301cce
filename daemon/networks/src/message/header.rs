//! Frame 0 of a message: the header, in MessagePack.
//!
//! Requests and replies are written as arrays, which are small and fast, in the form of the session's version. The
//! messages that open and close a session are written as maps, and readers ignore names that they do not know. A
//! message that opens or refuses a session is sent before a version is chosen. The form of such a message therefore
//! never changes; a later version may only add names.

use bytes::Bytes;
use peernet_clock::{RawTime, Span, WallTime};
use peernet_sample::{Description, Part, Sample};
use peernet_stream::{ConnectionStatistics, VersionMismatch, VersionRange};
use serde::{Deserialize, Serialize};

use super::{PeerClock, SESSION_VERSIONS, SessionAccepted, SessionHello, SessionId, deserialize_text};

/// Largest header in either direction. Bytes.
pub(crate) const MAX_HEADER_BYTES: usize = 64 * 1024;

/// Maximum number of payload parts of a sample.
pub(crate) const MAX_PARTS: usize = 64;

/// Maximum number of frames of a message: header, tree and payload parts.
pub(crate) const MAX_FRAMES: usize = 2 + MAX_PARTS;

/// Maximum number of partial answers to one request that are sent before the edge acknowledges them.
pub(crate) const MAX_UNREAD_PARTIAL_ANSWERS: u32 = 64;

/// Number of unacknowledged payload bytes of partial answers to one request at which the next partial answer has to
/// wait.
// After a cancellation, the partial answers that were sent delay all later answers on a slow link: 256 KiB take 0.1 s
// at 20 Mbit/s. A larger value would increase the throughput of large partial answers, which is at most this value in
// each round trip.
pub(crate) const MAX_UNREAD_BYTES: u64 = 256 * 1024;

/// Largest nesting depth of a header.
const MAX_DEPTH: usize = 32;

/// Error: a header cannot be sent or cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum HeaderError {
    #[error(
        "the header would have {0} bytes, more than {MAX_HEADER_BYTES}: shorten the sample's source, label or shapes"
    )]
    EncodedTooLong(usize),
    #[error("the sample has {0} parts, more than {MAX_PARTS}")]
    TooManyParts(usize),
    #[error("the header cannot be encoded: {0}")]
    NotEncodable(String),
    #[error("the header has {0} bytes, more than {MAX_HEADER_BYTES}")]
    ReceivedTooLong(usize),
    #[error("the header is invalid: {0}")]
    Unreadable(String),
    #[error("{0} bytes follow the end of the header")]
    TrailingBytes(usize),
    #[error("the hello has no protocol version that this program speaks: the peer speaks {peer}", peer = .0.peer)]
    NoCommonVersion(VersionMismatch),
    #[error("the header describes {described} payload parts, and {sent} were sent")]
    PartCount { described: usize, sent: usize },
}

/// The header of a message; each variant is one kind of message.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Header {
    /// The edge asks for a session.
    Open(Box<Open>),
    /// The cloud accepts the session.
    Accepted(Box<Accepted>),
    /// The cloud refuses the session, with the reason.
    Refused(Refused),
    /// The edge sends a sample. The tree and the payload follow.
    Request(Request),
    /// The cloud answers a request. The tree delta and the payload follow.
    Reply(Reply),
    /// The cloud sends a partial answer, before the answer is complete. The payload follows.
    PartialReply(PartialReply),
    /// The edge has read partial answers to a request, so the cloud may send more.
    #[serde(rename = "parts-read")]
    PartialAnswersRead(PartialAnswersRead),
    /// The edge does not wait for the answer to a request any more.
    Cancel(Cancel),
    /// The cloud reports the state of its clocks.
    Clock(Box<ClockUpdate>),
    /// The cloud reports what it has sent and received on the session's connection so far.
    Statistics(Box<StatisticsReport>),
    /// The cloud does not know the session, or does not know it any more.
    UnknownSession(UnknownSession),
    /// Either end closes the session.
    Goodbye(Goodbye),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Open {
    pub(crate) hello: SessionHello,
    /// Largest message that the edge accepts. Bytes.
    pub(crate) max_message_bytes: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Accepted {
    /// Version that the cloud chose for the session.
    pub(crate) protocol: u16,
    pub(crate) session: SessionId,
    pub(crate) accepted: SessionAccepted,
    /// Largest message that the cloud accepts. Bytes.
    pub(crate) max_message_bytes: u64,
    /// Maximum number of requests in flight that the cloud accepts.
    pub(crate) max_in_flight: u32,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Refused {
    /// Versions that the cloud speaks.
    #[serde(flatten)]
    pub(crate) versions: VersionRange,
    pub(crate) kind: RefusalKind,
    #[serde(deserialize_with = "deserialize_text")]
    pub(crate) reason: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum RefusalKind {
    /// The cloud does not serve the requested model or device, or has reached a limit of sessions.
    Refused,
    /// The cloud speaks no version of the protocol that the edge speaks.
    Incompatible,
}

/// Departure of a message. It is stamped after the tree was encoded, so that `upload` and `download` contain the
/// network and not the encoding. The receiver adds the transit node to the tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Departure {
    /// Sender's wall clock at the departure.
    pub(crate) sent: WallTime,
    /// The same moment on the sender's monotonic clock, relative to its anchor in the tree. The cloud's anchor is the
    /// arrival of the request. In a reply the value is therefore the time from the arrival of the request to the
    /// departure of the reply.
    #[serde(rename = "start")]
    pub(crate) sent_since_anchor: Span,
    /// Sender's epoch. The edge compares the epoch of a reply with [`Reply::arrival_epoch`]; the epoch of a reply is
    /// therefore read after `sent` was stamped. The epochs of other messages are not compared with any epoch. The value
    /// is [`peernet_clock::Clock::epoch`]; in versions before [`RAW_STAMPS_SINCE`](super::RAW_STAMPS_SINCE) it is
    /// [`peernet_clock::Clock::wall_epoch`].
    pub(crate) epoch: u32,
    /// Sender's free-running clock at `sent`. Exists since [`RAW_STAMPS_SINCE`](super::RAW_STAMPS_SINCE).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) sent_raw: Option<RawTime>,
}

/// Description of a sample without its payload.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct SampleHeader {
    pub(crate) parts: Vec<Description>,
    pub(crate) source: String,
    pub(crate) label: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Request {
    pub(crate) session: SessionId,
    pub(crate) request: u64,
    pub(crate) departure: Departure,
    pub(crate) sample: SampleHeader,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Reply {
    pub(crate) session: SessionId,
    pub(crate) request: u64,
    /// Departure of the reply. Present if and only if the reply has a tree delta. A reply that no model computed has
    /// neither.
    pub(crate) departure: Option<Departure>,
    /// Cloud's epoch, read right before the arrival of the request was stamped. If it differs from the epoch of the
    /// departure, the cloud's clock was interrupted or stepped between the two stamps.
    pub(crate) arrival_epoch: u32,
    pub(crate) outcome: Outcome,
    /// Cloud's free-running clock at the arrival of the request. Present if `departure` is present, since version
    /// [`RAW_STAMPS_SINCE`](super::RAW_STAMPS_SINCE).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) arrived_raw: Option<RawTime>,
}

/// Message with a partial answer. Exists since [`PARTIAL_REPLIES_SINCE`](super::PARTIAL_REPLIES_SINCE).
///
/// The reply repeats the whole answer. An edge can therefore ignore partial replies, and the content of a lost partial
/// reply still arrives with the reply.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PartialReply {
    pub(crate) session: SessionId,
    pub(crate) request: u64,
    /// Number of the partial answer, from 0.
    pub(crate) part: u32,
    /// Departure of the partial answer. As in a reply, its `sent_since_anchor` is the time since the arrival of the
    /// request.
    pub(crate) departure: Departure,
    pub(crate) sample: SampleHeader,
}

/// Acknowledgement of partial answers. A cloud sends at most [`MAX_UNREAD_PARTIAL_ANSWERS`] partial answers to a
/// request that are not acknowledged.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct PartialAnswersRead {
    pub(crate) session: SessionId,
    pub(crate) request: u64,
    /// Number of partial answers that count as read: the number of the newest partial answer that was read, plus one.
    /// Earlier partial answers that were lost count as read, too.
    #[serde(rename = "through")]
    pub(crate) read_count: u32,
}

/// Cancellation of a request. If the cloud sends a reply nevertheless, the edge drops the reply as late.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Cancel {
    pub(crate) session: SessionId,
    pub(crate) request: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Outcome {
    Answer(SampleHeader),
    Failed(#[serde(deserialize_with = "deserialize_text")] String),
    Overloaded(#[serde(deserialize_with = "deserialize_text")] String),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ClockUpdate {
    pub(crate) session: SessionId,
    pub(crate) clock: PeerClock,
}

/// Statistics of the cloud's end of a connection. Exists since [`STATISTICS_SINCE`](super::STATISTICS_SINCE).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StatisticsReport {
    pub(crate) session: SessionId,
    pub(crate) statistics: ConnectionStatistics,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct UnknownSession {
    pub(crate) session: SessionId,
    pub(crate) request: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Goodbye {
    pub(crate) session: SessionId,
    #[serde(deserialize_with = "deserialize_text")]
    pub(crate) reason: String,
    /// Number of iterations that the edge's run was planned to have, if the run is over. A cloud that serves a fixed
    /// number of requests then does not wait for missing requests. Releases without this field ignore it.
    #[serde(default, rename = "ordered", skip_serializing_if = "Option::is_none")]
    pub(crate) planned_iterations: Option<u64>,
}

impl Header {
    /// Encodes the header.
    ///
    /// # Errors
    /// If the header is longer than [`MAX_HEADER_BYTES`].
    pub(crate) fn encode(&self) -> Result<Bytes, HeaderError> {
        let mut wire = Vec::with_capacity(256);
        let written = match self {
            // Field names would take most of the bytes of these frequent messages.
            Self::Request(_) | Self::Reply(_) | Self::PartialReply(_) => {
                rmp_serde::encode::write(&mut wire, self)
            }
            _ => rmp_serde::encode::write_named(&mut wire, self),
        };
        written.map_err(|error| HeaderError::NotEncodable(error.to_string()))?;
        // The peer would refuse the header, so the error is reported where the cause is known.
        if wire.len() > MAX_HEADER_BYTES {
            Err(HeaderError::EncodedTooLong(wire.len()))
        } else {
            Ok(wire.into())
        }
    }

    /// Decodes a header from an untrusted peer.
    ///
    /// # Errors
    /// If the bytes are not exactly one header of a version that this release speaks.
    pub(crate) fn decode(wire: &[u8]) -> Result<Self, HeaderError> {
        if wire.len() > MAX_HEADER_BYTES {
            return Err(HeaderError::ReceivedTooLong(wire.len()));
        }
        let mut reader = rmp_serde::Deserializer::new(wire);
        // A deeply nested header could exhaust the stack.
        reader.set_max_depth(MAX_DEPTH);
        // A later version may change everything in a hello except its versions. An unreadable hello is therefore
        // reported as a version mismatch where its versions show one.
        let header = Self::deserialize(&mut reader).map_err(|error| {
            version_mismatch(wire)
                .map_or_else(|| HeaderError::Unreadable(error.to_string()), HeaderError::NoCommonVersion)
        })?;
        match reader.get_ref().len() {
            0 => Ok(header),
            rest => Err(HeaderError::TrailingBytes(rest)),
        }
    }
}

/// Returns the version mismatch of a hello that is unreadable apart from its versions. `None` if a common version
/// exists or the versions are unreadable as well.
fn version_mismatch(wire: &[u8]) -> Option<VersionMismatch> {
    #[derive(Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum MessageVersions {
        Open(OpenVersions),
    }
    #[derive(Deserialize)]
    struct OpenVersions {
        hello: HelloVersions,
    }
    #[derive(Deserialize)]
    struct HelloVersions {
        #[serde(flatten)]
        versions: VersionRange,
    }
    // Only the names on the way to the versions are read; everything else may have changed.
    let MessageVersions::Open(open) = rmp_serde::from_slice(wire).ok()?;
    SESSION_VERSIONS.highest_common(&open.hello.versions).err()
}

impl SampleHeader {
    /// Returns the header of a sample.
    ///
    /// # Errors
    /// If the sample has more than [`MAX_PARTS`] parts.
    pub(crate) fn from_sample(sample: &Sample) -> Result<Self, HeaderError> {
        if sample.parts.len() > MAX_PARTS {
            return Err(HeaderError::TooManyParts(sample.parts.len()));
        }
        Ok(Self {
            parts: sample.parts.iter().map(|part| part.description.clone()).collect(),
            source: sample.source.clone(),
            label: sample.label.clone(),
        })
    }

    /// Combines this description with payload frames into a sample.
    ///
    /// # Errors
    /// If the numbers of frames and descriptions differ.
    pub(crate) fn into_sample(
        self,
        payload: impl ExactSizeIterator<Item = Bytes>,
    ) -> Result<Sample, HeaderError> {
        let (described, sent) = (self.parts.len(), payload.len());
        if described != sent {
            return Err(HeaderError::PartCount { described, sent });
        }
        let parts = self.parts.into_iter().zip(payload);
        let parts = parts.map(|(description, bytes)| Part { description, bytes }).collect();
        Ok(Sample { parts, source: self.source, label: self.label })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::message::strategies;

    proptest! {
        #[test]
        fn every_header_reads_back_as_written(header in strategies::header(Vec::new())) {
            let wire = header.encode().expect("short enough");
            prop_assert_eq!(Header::decode(&wire), Ok(header));
        }

        #[test]
        fn any_header_bytes_are_read_without_panic(wire in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = Header::decode(&wire);
        }

        #[test]
        fn truncated_or_extended_header_is_refused(
            header in strategies::header(Vec::new()),
            position: prop::sample::Index,
            byte: u8,
        ) {
            let wire = header.encode().expect("short enough");
            let position = position.index(wire.len());
            prop_assert!(Header::decode(&wire[..position]).is_err());
            let mut longer = wire.to_vec();
            longer.push(byte);
            prop_assert!(Header::decode(&longer).is_err());
            let mut damaged = wire.to_vec();
            damaged[position] = byte;
            // A damaged header may still be valid. Decoding must only not panic.
            let _ = Header::decode(&damaged);
        }
    }

    #[test]
    fn sample_with_missing_or_extra_frames_is_refused() {
        let part = |text: &'static str| Part { description: Description::bytes(), bytes: text.into() };
        let sample = Sample { parts: vec![part("a"), part("b")], source: "s".into(), label: None };
        let header = SampleHeader::from_sample(&sample).expect("two parts");
        let frames: [Bytes; 3] = ["a".into(), "b".into(), "c".into()];
        assert_eq!(header.clone().into_sample(frames[..2].iter().cloned()), Ok(sample));
        for wrong_count in [1, 3] {
            let assembled = header.clone().into_sample(frames[..wrong_count].iter().cloned());
            assert_eq!(assembled, Err(HeaderError::PartCount { described: 2, sent: wrong_count }));
        }
    }

    #[test]
    fn header_limits_hold_for_encoding_and_decoding() {
        let too_many_parts = Sample {
            parts: vec![Part { description: Description::bytes(), bytes: Bytes::new() }; MAX_PARTS + 1],
            source: String::new(),
            label: None,
        };
        assert_eq!(SampleHeader::from_sample(&too_many_parts), Err(HeaderError::TooManyParts(MAX_PARTS + 1)));
        let goodbye = super::super::Goodbye {
            session: SessionId::random(),
            reason: "x".repeat(MAX_HEADER_BYTES),
            planned_iterations: None,
        };
        assert!(matches!(Header::Goodbye(goodbye).encode(), Err(HeaderError::EncodedTooLong(_))));
        let oversize = vec![0xc0; MAX_HEADER_BYTES + 1];
        assert_eq!(Header::decode(&oversize), Err(HeaderError::ReceivedTooLong(MAX_HEADER_BYTES + 1)));
        let nested_arrays = [vec![0x91; 5_000], vec![0xc0]].concat();
        assert!(matches!(Header::decode(&nested_arrays), Err(HeaderError::Unreadable(_))));
    }

    #[test]
    fn text_of_peer_contains_no_control_characters() {
        let session = SessionId::random();
        let goodbye = |reason: &str| {
            Header::Goodbye(super::super::Goodbye {
                session,
                reason: reason.to_owned(),
                planned_iterations: None,
            })
        };
        let wire = goodbye("bye\n\u{1b}[2Jthere, 30 °C").encode().expect("short enough");
        assert_eq!(Header::decode(&wire), Ok(goodbye("bye  [2Jthere, 30 °C")));
    }

    proptest! {
        #[test]
        fn cloud_information_contains_no_control_characters(mut accepted in strategies::accepted()) {
            let unprintable = || "cpu\u{1b}[2J".to_owned();
            (accepted.version, accepted.device, accepted.facts) = (unprintable(), unprintable(), vec![(unprintable(), unprintable())]);
            let (protocol, session) = (SESSION_VERSIONS.newest(), SessionId::random());
            let header = Accepted { protocol, session, accepted, max_message_bytes: 1, max_in_flight: 1 };
            let wire = Header::Accepted(Box::new(header)).encode().expect("short enough");
            let Ok(Header::Accepted(read)) = Header::decode(&wire) else { panic!("not an acceptance") };
            let SessionAccepted { version, device, facts, .. } = read.accepted;
            for text in [&version, &device, &facts[0].0, &facts[0].1] {
                prop_assert_eq!(text, "cpu [2J");
            }
        }
    }

    #[test]
    fn unreadable_hello_of_later_version_is_version_mismatch() {
        #[derive(Serialize)]
        #[serde(rename_all = "kebab-case")]
        enum LaterMessage {
            Open { hello: LaterHello, colour: &'static str },
        }
        #[derive(Serialize)]
        struct LaterHello {
            protocol: u16,
            newest: u16,
            host: [u64; 3],
        }
        let later_version = SESSION_VERSIONS.newest() + 1;
        let hello = LaterHello { protocol: later_version, newest: later_version + 1, host: [1, 2, 3] };
        let wire =
            rmp_serde::to_vec_named(&LaterMessage::Open { hello, colour: "green" }).expect("serialises");
        let Err(HeaderError::NoCommonVersion(mismatch)) = Header::decode(&wire) else {
            panic!("no version mismatch")
        };
        assert_eq!((mismatch.peer.oldest(), mismatch.peer.newest()), (later_version, later_version + 1));
    }
}
