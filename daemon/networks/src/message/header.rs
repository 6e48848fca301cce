//! Frame 0: what a message is, in MessagePack.
//!
//! Requests and replies are written as arrays, small and fast, in the form of the session's version. The messages that open
//! and close a session are written as maps: a reader ignores names that it does not know. What opens a session or refuses it
//! is sent before a version is chosen, so that a later version may add names to it and changes nothing else.

use bytes::Bytes;
use peernet_clock::{RawTime, Span, WallTime};
use peernet_sample::{Description, Part, Sample};
use peernet_stream::{ConnectionStatistics, VersionMismatch, VersionRange};
use serde::{Deserialize, Serialize};

use super::{PeerClock, SESSION_VERSIONS, SessionAccepted, SessionHello, SessionId, words};

/// Largest header, both ways. Bytes.
pub(crate) const MAX_HEADER_BYTES: usize = 64 * 1024;

/// Most payload parts of a sample.
pub(crate) const MAX_PARTS: usize = 64;

/// Most frames of a message.
pub(crate) const MAX_FRAMES: usize = 2 + MAX_PARTS;

/// Deepest nesting of a header.
const MAX_DEPTH: usize = 32;

/// A header that cannot be sent or cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum HeaderError {
    #[error("the header would take {0} bytes, more than {MAX_HEADER_BYTES}: shorten source, label or shapes")]
    TooLong(usize),
    #[error("the sample has {0} parts, more than {MAX_PARTS}")]
    TooManyParts(usize),
    #[error("the header cannot be encoded: {0}")]
    Unencodable(String),
    #[error("a header of {0} bytes, more than {MAX_HEADER_BYTES}")]
    Oversize(usize),
    #[error("no header: {0}")]
    Unreadable(String),
    #[error("{0} bytes after the header's end")]
    Trailing(usize),
    #[error("a hello of {peer}", peer = .0.peer)]
    NoCommonVersion(VersionMismatch),
    #[error("{described} parts described, {sent} sent")]
    PartCount { described: usize, sent: usize },
}

/// Every kind of message.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Header {
    /// Edge: let us begin.
    Open(Box<Open>),
    /// Cloud: the session exists.
    Accepted(Box<Accepted>),
    /// Cloud: it does not, and why.
    Refused(Refused),
    /// Edge: compute on this. Followed by the tree and the payload.
    Request(Request),
    /// Cloud: the answer. Followed by the tree's growth and the payload.
    Reply(Reply),
    /// Cloud: this is known of my wall clock from now on.
    Clock(Box<ClockNews>),
    /// Cloud: this was sent and received at my end of the session's connection so far.
    Statistics(Box<CountedAtCloud>),
    /// Cloud: there is no such session here (any more).
    UnknownSession(UnknownSession),
    /// Either: the session is over.
    Goodbye(Goodbye),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Open {
    pub(crate) hello: SessionHello,
    /// Largest message the edge takes. Bytes.
    pub(crate) max_message_bytes: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Accepted {
    /// The version that the cloud chose for the session.
    pub(crate) protocol: u16,
    pub(crate) session: SessionId,
    pub(crate) accepted: SessionAccepted,
    /// Largest message the cloud takes. Bytes.
    pub(crate) max_message_bytes: u64,
    /// Requests that the cloud takes at once.
    pub(crate) max_in_flight: u32,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Refused {
    /// The versions that the cloud speaks.
    #[serde(flatten)]
    pub(crate) versions: VersionRange,
    pub(crate) kind: RefusalKind,
    #[serde(deserialize_with = "words")]
    pub(crate) reason: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum RefusalKind {
    /// The cloud does not serve what was asked for.
    Refused,
    /// The cloud speaks no version of the protocol that the edge speaks.
    Incompatible,
}

/// When a message was handed to the network, stamped as late as possible: after its tree was encoded, so that
/// `upload` and `download` are not lengthened by it. The receiver puts the transit into the tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Departure {
    /// What the sender's wall clock showed.
    pub(crate) sent: WallTime,
    /// The same moment on its monotonic clock, from its anchor in the tree. The cloud's anchor is the arrival of
    /// the request, so that in a reply this is how long the request was there.
    pub(crate) start: Span,
    /// The sender's epoch, read after `sent` was stamped: [`peernet_clock::Clock::epoch`], before [`RAW_STAMPS_SINCE`](super::RAW_STAMPS_SINCE)
    /// [`peernet_clock::Clock::wall_epoch`].
    pub(crate) epoch: u32,
    /// What the sender's free-running clock showed at `sent`; since [`RAW_STAMPS_SINCE`](super::RAW_STAMPS_SINCE).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) sent_raw: Option<RawTime>,
}

/// What is said about a sample besides its payload.
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
    /// Present when the tree's growth is: an answer that no model made carries neither.
    pub(crate) departure: Option<Departure>,
    /// The cloud's epoch right before the request's arrival was stamped. Another than the departure's: its clock was
    /// stepped in between.
    pub(crate) arrival_epoch: u32,
    pub(crate) outcome: Outcome,
    /// What the cloud's free-running clock showed when the request had arrived; with `departure`, since [`RAW_STAMPS_SINCE`](super::RAW_STAMPS_SINCE).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) arrived_raw: Option<RawTime>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Outcome {
    Answer(SampleHeader),
    Failed(#[serde(deserialize_with = "words")] String),
    Overloaded(#[serde(deserialize_with = "words")] String),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ClockNews {
    pub(crate) session: SessionId,
    pub(crate) clock: PeerClock,
}

/// Since [`STATISTICS_SINCE`](super::STATISTICS_SINCE).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct CountedAtCloud {
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
    #[serde(deserialize_with = "words")]
    pub(crate) reason: String,
    /// Edge, once the run that the session was for is over: how many iterations it was to have. Older versions say
    /// nothing of it and pass it over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) ordered: Option<u64>,
}

impl Header {
    /// The wire form.
    ///
    /// # Errors
    /// When it would be longer than the peer accepts.
    pub(crate) fn encode(&self) -> Result<Bytes, HeaderError> {
        let mut wire = Vec::with_capacity(256);
        let written = match self {
            Self::Request(_) | Self::Reply(_) => rmp_serde::encode::write(&mut wire, self),
            _ => rmp_serde::encode::write_named(&mut wire, self),
        };
        written.map_err(|error| HeaderError::Unencodable(error.to_string()))?;
        if wire.len() > MAX_HEADER_BYTES { Err(HeaderError::TooLong(wire.len())) } else { Ok(wire.into()) }
    }

    /// Reads a wire form that anybody may have written.
    ///
    /// # Errors
    /// When it is not exactly one header of this protocol's version.
    pub(crate) fn decode(wire: &[u8]) -> Result<Self, HeaderError> {
        if wire.len() > MAX_HEADER_BYTES {
            return Err(HeaderError::Oversize(wire.len()));
        }
        let mut reader = rmp_serde::Deserializer::new(wire);
        reader.set_max_depth(MAX_DEPTH);
        let header = Self::deserialize(&mut reader).map_err(|error| {
            mismatch(wire)
                .map_or_else(|| HeaderError::Unreadable(error.to_string()), HeaderError::NoCommonVersion)
        })?;
        match reader.get_ref().len() {
            0 => Ok(header),
            rest => Err(HeaderError::Trailing(rest)),
        }
    }
}

/// Returns the versions of a hello whose remainder cannot be read, where none of them is spoken here.
fn mismatch(wire: &[u8]) -> Option<VersionMismatch> {
    #[derive(Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Probe {
        Open(OpenProbe),
    }
    #[derive(Deserialize)]
    struct OpenProbe {
        hello: HelloProbe,
    }
    #[derive(Deserialize)]
    struct HelloProbe {
        #[serde(flatten)]
        versions: VersionRange,
    }
    let Probe::Open(open) = rmp_serde::from_slice(wire).ok()?;
    SESSION_VERSIONS.highest_common(&open.hello.versions).err()
}

impl SampleHeader {
    /// What to say about a sample.
    ///
    /// # Errors
    /// When it has more parts than a message has frames.
    pub(crate) fn of(sample: &Sample) -> Result<Self, HeaderError> {
        if sample.parts.len() > MAX_PARTS {
            return Err(HeaderError::TooManyParts(sample.parts.len()));
        }
        Ok(Self {
            parts: sample.parts.iter().map(|part| part.description.clone()).collect(),
            source: sample.source.clone(),
            label: sample.label.clone(),
        })
    }

    /// The sample of this description and these payload frames.
    ///
    /// # Errors
    /// When there are more or fewer frames than descriptions.
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
        fn no_bytes_can_panic(wire in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = Header::decode(&wire);
        }

        #[test]
        fn no_damage_can_panic_and_no_part_is_a_whole(
            header in strategies::header(Vec::new()),
            at: prop::sample::Index,
            byte: u8,
        ) {
            let wire = header.encode().expect("short enough");
            let at = at.index(wire.len());
            prop_assert!(Header::decode(&wire[..at]).is_err());
            let mut longer = wire.to_vec();
            longer.push(byte);
            // A header of another version may be longer, and is then said to be of that version.
            prop_assert!(Header::decode(&longer).is_err());
            let mut damaged = wire.to_vec();
            damaged[at] = byte;
            let _ = Header::decode(&damaged);
        }
    }

    #[test]
    fn a_sample_is_put_together_only_from_all_of_its_parts() {
        let part = |text: &'static str| Part { description: Description::bytes(), bytes: text.into() };
        let sample = Sample { parts: vec![part("a"), part("b")], source: "s".into(), label: None };
        let header = SampleHeader::of(&sample).expect("two parts");
        let frames: [Bytes; 3] = ["a".into(), "b".into(), "c".into()];
        assert_eq!(header.clone().into_sample(frames[..2].iter().cloned()), Ok(sample));
        for wrong in [1, 3] {
            let put_together = header.clone().into_sample(frames[..wrong].iter().cloned());
            assert_eq!(put_together, Err(HeaderError::PartCount { described: 2, sent: wrong }));
        }
    }

    #[test]
    fn limits_hold_when_writing_and_when_reading() {
        let many = Sample {
            parts: vec![Part { description: Description::bytes(), bytes: Bytes::new() }; MAX_PARTS + 1],
            source: String::new(),
            label: None,
        };
        assert_eq!(SampleHeader::of(&many), Err(HeaderError::TooManyParts(MAX_PARTS + 1)));
        let goodbye = super::super::Goodbye {
            session: SessionId::random(),
            reason: "x".repeat(MAX_HEADER_BYTES),
            ordered: None,
        };
        assert!(matches!(Header::Goodbye(goodbye).encode(), Err(HeaderError::TooLong(_))));
        let oversize = vec![0xc0; MAX_HEADER_BYTES + 1];
        assert_eq!(Header::decode(&oversize), Err(HeaderError::Oversize(MAX_HEADER_BYTES + 1)));
        let deep = [vec![0x91; 5_000], vec![0xc0]].concat();
        assert!(matches!(Header::decode(&deep), Err(HeaderError::Unreadable(_))));
    }

    #[test]
    fn a_peers_words_cannot_drive_a_terminal() {
        let session = SessionId::random();
        let goodbye = |reason: &str| {
            Header::Goodbye(super::super::Goodbye { session, reason: reason.to_owned(), ordered: None })
        };
        let wire = goodbye("bye\n\u{1b}[2Jthere, 30 °C").encode().expect("short enough");
        assert_eq!(Header::decode(&wire), Ok(goodbye("bye  [2Jthere, 30 °C")));
    }

    proptest! {
        #[test]
        fn nor_can_what_a_cloud_says_of_itself(mut accepted in strategies::accepted()) {
            let evil = || "cpu\u{1b}[2J".to_owned();
            (accepted.version, accepted.device, accepted.facts) = (evil(), evil(), vec![(evil(), evil())]);
            let (protocol, session) = (SESSION_VERSIONS.newest(), SessionId::random());
            let header = Accepted { protocol, session, accepted, max_message_bytes: 1, max_in_flight: 1 };
            let wire = Header::Accepted(Box::new(header)).encode().expect("short enough");
            let Ok(Header::Accepted(read)) = Header::decode(&wire) else { panic!("it is one") };
            let SessionAccepted { version, device, facts, .. } = read.accepted;
            for text in [&version, &device, &facts[0].0, &facts[0].1] {
                prop_assert_eq!(text, "cpu [2J");
            }
        }
    }

    #[test]
    fn unreadable_hello_of_later_version_is_recognised() {
        #[derive(Serialize)]
        #[serde(rename_all = "kebab-case")]
        enum Later {
            Open { hello: LaterHello, colour: &'static str },
        }
        #[derive(Serialize)]
        struct LaterHello {
            protocol: u16,
            newest: u16,
            host: [u64; 3],
        }
        let later = SESSION_VERSIONS.newest() + 1;
        let hello = LaterHello { protocol: later, newest: later + 1, host: [1, 2, 3] };
        let wire = rmp_serde::to_vec_named(&Later::Open { hello, colour: "green" }).expect("serialises");
        let Err(HeaderError::NoCommonVersion(mismatch)) = Header::decode(&wire) else {
            panic!("it has none")
        };
        assert_eq!((mismatch.peer.oldest(), mismatch.peer.newest()), (later, later + 1));
    }
}
