//! Request for the stamps of observed messages, and the answer, as JSON documents.

use bytes::Bytes;
use peernet_clock::{RawTime, Span, WallTime};
use peernet_logger::Slug;
use peernet_sample::{Description, MediaType, Sample};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::config::PairBy;
use crate::link::HostStamp;

/// Version of requests and answers. Unknown fields are ignored, so that fields may be added within a version.
pub(super) const VERSION: u32 = 1;

/// Maximum number of messages in a request.
pub(crate) const MAX_KEYS: usize = 256;

/// Longest request or answer in bytes. It is several times the size of [`MAX_KEYS`] keys, and so short that a message
/// does not delay the receiver's other peers.
const MAX_MESSAGE_BYTES: usize = 256 << 10;

/// Request for the stamps of messages.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct StampRequest {
    pub(super) version: u32,
    /// Name of the pipeline on the host that receives the request.
    pub(super) pipeline: Slug,
    /// Rule by which the requesting pipeline pairs messages.
    pub(super) pair_by: PairBy,
    /// Keys of the messages: `header.stamp` in nanoseconds, or `header.seq`.
    pub(super) keys: Vec<i64>,
}

/// Answer with the stamps of each key, in the order of the request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct StampAnswer {
    pub(super) version: u32,
    pub(crate) pairs: Vec<ObservedPair>,
}

/// Stamps of an input message and of the output message that belongs to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct ObservedPair {
    /// Key by which both messages are paired.
    pub(crate) key: i64,
    /// Stamp of the input message; `None` if the message was not received.
    input: Option<SerializedStamp>,
    /// Stamp of the output message; `None` if the message was not received.
    output: Option<SerializedStamp>,
    /// Nanoseconds from the input message to the output message, on the monotonic clock.
    elapsed_ns: Option<i64>,
}

/// A stamp as it is sent to another host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct SerializedStamp {
    /// Reading of the wall clock in nanoseconds since 1970.
    wall_ns: i64,
    /// Reading of the free-running clock in nanoseconds.
    raw_ns: i64,
    /// Number of earlier interruptions of the free-running clock; absent if the clock was interrupted near the stamp.
    #[serde(default)]
    epoch: Option<u32>,
}

/// Reason why a request or an answer cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StampMessageError {
    #[error("it has no payload")]
    Empty,
    #[error("it has {0} bytes, more than {MAX_MESSAGE_BYTES}")]
    TooLong(usize),
    #[error("it is not a JSON document as in docs/session-protocol.md: {0}")]
    Json(#[from] serde_json::Error),
    #[error(
        "it has version {0}, and this agent supports version {VERSION}; update the older of the two agents"
    )]
    Version(u32),
}

impl StampRequest {
    pub(crate) const fn new(pipeline: Slug, pair_by: PairBy, keys: Vec<i64>) -> Self {
        Self { version: VERSION, pipeline, pair_by, keys }
    }

    pub(crate) fn to_sample(&self) -> Result<Sample, StampMessageError> {
        sample_from(self)
    }

    pub(super) fn read(sample: &Sample) -> Result<Self, StampMessageError> {
        read_document(sample)
    }
}

impl StampAnswer {
    pub(super) const fn new(pairs: Vec<ObservedPair>) -> Self {
        Self { version: VERSION, pairs }
    }

    pub(super) fn to_sample(&self) -> Result<Sample, StampMessageError> {
        sample_from(self)
    }

    /// Reads an answer.
    ///
    /// # Errors
    /// When the sample is not an answer of this version.
    pub(crate) fn read(sample: &Sample) -> Result<Self, StampMessageError> {
        read_document(sample)
    }
}

impl ObservedPair {
    pub(crate) fn new(
        key: i64,
        input: Option<HostStamp>,
        output: Option<HostStamp>,
        elapsed: Option<Span>,
    ) -> Self {
        let (input, output) = (input.map(SerializedStamp::from), output.map(SerializedStamp::from));
        Self { key, input, output, elapsed_ns: elapsed.map(Span::nanos) }
    }

    pub(crate) fn input(&self) -> Option<HostStamp> {
        self.input.map(HostStamp::from)
    }

    pub(crate) fn output(&self) -> Option<HostStamp> {
        self.output.map(HostStamp::from)
    }

    /// Returns the time from the input message to the output message by the host's monotonic clock.
    pub(crate) fn elapsed(&self) -> Option<Span> {
        self.elapsed_ns.map(Span::from_nanos)
    }

    /// Returns whether both messages were received.
    pub(crate) const fn is_complete(&self) -> bool {
        self.input.is_some() && self.output.is_some() && self.elapsed_ns.is_some()
    }
}

impl From<HostStamp> for SerializedStamp {
    fn from(HostStamp { wall, raw, epoch }: HostStamp) -> Self {
        Self { wall_ns: wall.unix_nanos(), raw_ns: raw.nanos(), epoch }
    }
}

impl From<SerializedStamp> for HostStamp {
    fn from(SerializedStamp { wall_ns, raw_ns, epoch }: SerializedStamp) -> Self {
        Self { wall: WallTime::from_unix_nanos(wall_ns), raw: RawTime::from_nanos(raw_ns), epoch }
    }
}

/// Returns a sample whose only part is the message as JSON.
fn sample_from(message: &impl Serialize) -> Result<Sample, StampMessageError> {
    let document = serde_json::to_vec(message)?;
    Ok(Sample::from_part(Description::unshaped(MediaType::Json), Bytes::from(document)))
}

/// Reads a message of this version from the first part of a sample.
fn read_document<T: DeserializeOwned>(sample: &Sample) -> Result<T, StampMessageError> {
    /// Part of the document that every version has.
    #[derive(Deserialize)]
    struct DocumentVersion {
        version: u32,
    }
    let part = sample.parts.first().ok_or(StampMessageError::Empty)?;
    if part.bytes.len() > MAX_MESSAGE_BYTES {
        return Err(StampMessageError::TooLong(part.bytes.len()));
    }
    // The version is read first, because a document of another version may have other fields.
    let DocumentVersion { version } = serde_json::from_slice(&part.bytes)?;
    if version != VERSION {
        return Err(StampMessageError::Version(version));
    }
    Ok(serde_json::from_slice(&part.bytes)?)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;

    use super::*;

    fn document(text: &str) -> Sample {
        Sample::from_part(Description::unshaped(MediaType::Json), Bytes::copy_from_slice(text.as_bytes()))
    }

    /// Reads a file of `tests/fixtures/wire/observed`: documents of version 1, which must stay readable. An existing
    /// file is never changed.
    fn fixture(name: &str) -> Vec<u8> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/wire/observed");
        std::fs::read(folder.join(name)).expect("the fixture is there")
    }

    #[test]
    fn messages_have_the_bytes_of_the_fixtures() {
        let keys = vec![1_700_000_000_000_000_001, -1];
        let request = StampRequest::new("detector".parse().expect("a name"), PairBy::Stamp, keys.clone());
        let stamp = |wall_ns, epoch| HostStamp {
            wall: WallTime::from_unix_nanos(wall_ns),
            raw: RawTime::from_nanos(wall_ns + 7),
            epoch,
        };
        let (input, output) =
            (stamp(1_700_000_000_030_000_000, Some(3)), stamp(1_700_000_000_050_000_000, None));
        let pair = ObservedPair::new(keys[0], Some(input), Some(output), Some(Span::from_millis(20)));
        assert!(pair.is_complete());
        let answer = StampAnswer::new(vec![pair, ObservedPair::new(keys[1], None, None, None)]);

        let stored = |name| document(&String::from_utf8_lossy(&fixture(name)));
        assert_eq!(StampRequest::read(&stored("request.json")).expect("it can be read"), request);
        assert_eq!(StampAnswer::read(&stored("answer.json")).expect("it can be read"), answer);
        let written = |sample: Result<Sample, _>| sample.expect("it can be written").parts[0].bytes.to_vec();
        assert_eq!(written(request.to_sample()), fixture("request.json"));
        assert_eq!(written(answer.to_sample()), fixture("answer.json"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200), at in 0..200_usize) {
            let mut mutated = fixture("answer.json");
            let end = (at + bytes.len()).min(mutated.len());
            mutated.splice(at..end.max(at), bytes.iter().copied());
            for bytes in [bytes, mutated] {
                let sample = Sample::from_part(Description::bytes(), bytes.into());
                let _ = (StampRequest::read(&sample), StampAnswer::read(&sample));
            }
        }
    }

    #[test]
    fn documented_form_is_read_with_unknown_fields() {
        let request = document(
            r#"{"version": 1, "pipeline": "detector", "pair_by": "stamp", "keys": [1700000000000000001], "more": 2}"#,
        );
        assert_eq!(StampRequest::read(&request).expect("it can be read").keys, [1_700_000_000_000_000_001]);
        let answer = document(
            r#"{"version": 1, "pairs": [{"key": 5, "input": {"wall_ns": 10, "raw_ns": 11, "epoch": 0, "more": 1}, "output": {"wall_ns": 30, "raw_ns": 31},
                "elapsed_ns": 20}]}"#,
        );
        let pair = StampAnswer::read(&answer).expect("it can be read").pairs[0];
        assert!(pair.is_complete());
        assert_eq!(pair.elapsed(), Some(Span::from_nanos(20)));
        assert_eq!(pair.output().expect("it is there").epoch, None);
    }

    #[test]
    fn other_versions_and_invalid_documents_are_refused() {
        let error = StampAnswer::read(&document(r#"{"version": 2, "stamps": {}}"#))
            .expect_err("version 2 is not supported");
        for part in ["version 2", "version 1", "update"] {
            assert!(error.to_string().contains(part), "{error}");
        }
        assert!(matches!(
            StampRequest::read(&document(&" ".repeat(MAX_MESSAGE_BYTES + 1))),
            Err(StampMessageError::TooLong(_))
        ));
        for nonsense in ["", "[]", "{}", r#"{"version": 1}"#, r#"{"version": -1}"#] {
            assert!(StampRequest::read(&document(nonsense)).is_err(), "{nonsense}");
        }
    }
}
