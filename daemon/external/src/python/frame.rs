//! Messages over the pipes.
//!
//! A message consists of [`MESSAGE_PREFIX`], the length of the header, the header as JSON, and the bytes of those
//! parts that are not in shared memory.

use std::os::fd::RawFd;

use bytes::Bytes;
use peernet_sample::{Description, Part};
use serde::{Deserialize, Serialize};

use super::{Images, ObjectDescription, Role, Step};
use crate::text::deserialize_printable;

/// First bytes of every message. A message without these bytes shows that custom code wrote to the pipe.
pub(super) const MESSAGE_PREFIX: [u8; 4] = *b"PN1\n";
/// Number of bytes before the header: [`MESSAGE_PREFIX`] and the header's length.
pub(super) const PREFIX_BYTES: usize = 8;
/// Longest header, bytes.
pub(super) const MAX_HEADER_BYTES: usize = 1 << 20;
/// Largest size of all parts of a value, bytes (1 GiB).
pub(super) const MAX_VALUE_BYTES: u64 = 1 << 30;
/// Media type of a pickled object. The parts after the pickled object are its buffers (pickle protocol 5, PEP 574).
pub const PICKLE: &str = "application/x-python-pickle";

/// Media type of Python's lists, tuples and dictionaries that JSON cannot represent. JSON cannot
/// represent bytes, arrays and pictures (their parts follow the tree), numbers that are not finite, and keys that are
/// not texts.
pub const TREE: &str = "application/x-python-tree";

/// Request to the worker.
#[derive(Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Request<'a> {
    /// Creates the object. `shared_memory` is the descriptor of the inherited file whose memory is shared.
    Start {
        module: &'a str,
        path: &'a str,
        role: Role,
        pickle: bool,
        images: Images,
        #[serde(rename = "window")]
        shared_memory: RawFd,
    },
    /// Calls the object with the parts that follow.
    Call { parts: Vec<PartHead> },
    /// Calls `reset()` of the object.
    Reset {},
    /// Continues the call after a partial answer.
    Proceed {},
    /// Ends the call after a partial answer, because the request was cancelled.
    Cancel {},
    /// Calls `advance(seconds)` of the object.
    Advance { seconds: f64 },
}

/// Reply of the worker.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Reply {
    /// The object has been created.
    Ready(ObjectDescription),
    /// The returned value, and the steps with the stamps of their beginning and end, in nanoseconds.
    Value {
        parts: Vec<PartHead>,
        #[serde(rename = "stages")]
        steps: Vec<(Step, i64, i64)>,
    },
    /// A partial answer of a model. The process waits for [`Request::Proceed`] or [`Request::Cancel`].
    #[serde(rename = "part")]
    PartialAnswer { parts: Vec<PartHead> },
    /// The sensor has no more samples.
    #[serde(rename = "over")]
    EndOfSamples {
        #[serde(rename = "stages")]
        steps: Vec<(Step, i64, i64)>,
    },
    /// Custom code raised an exception.
    Raised {
        #[serde(deserialize_with = "deserialize_printable")]
        text: String,
        #[serde(rename = "stages")]
        steps: Vec<(Step, i64, i64)>,
    },
    /// The value cannot be transferred.
    #[serde(rename = "refused")]
    UnsupportedValue {
        #[serde(deserialize_with = "deserialize_printable")]
        text: String,
        #[serde(rename = "stages")]
        steps: Vec<(Step, i64, i64)>,
    },
}

/// Part without its bytes.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct PartHead {
    pub(super) description: Description,
    pub(super) length: u64,
    /// Position of the bytes in the shared memory; `None` if they follow in the pipe.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) at: Option<u64>,
}

impl PartHead {
    pub(super) fn new(part: &Part, at: Option<u64>) -> Self {
        Self { description: part.description.clone(), length: part.bytes.len() as u64, at }
    }
}

/// Returns the parts of a message: their heads with their bytes.
pub(super) fn join_parts(heads: Vec<PartHead>, bytes: Vec<Bytes>) -> Vec<Part> {
    let parts = heads.into_iter().zip(bytes);
    parts.map(|(head, bytes)| Part { description: head.description, bytes }).collect()
}

/// Defect of a message from the worker.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// The message does not begin with `PN1`.
    #[error("it starts with {0:?} instead of PN1; does custom code write to the pipe of PEERNet?")]
    Prefix(String),
    /// The header is longer than allowed.
    #[error("its header has {0} bytes, the limit is {MAX_HEADER_BYTES}")]
    HeaderLength(usize),
    /// The header cannot be read or written.
    #[error(transparent)]
    Header(#[from] serde_json::Error),
    /// The parts are longer than allowed.
    #[error("its parts have more than {MAX_VALUE_BYTES} bytes together")]
    ValueLength,
    /// The worker sent a message that does not answer the request.
    #[error("it sent a message that does not answer the request")]
    UnexpectedReply,
    /// The part is not within the shared memory.
    #[error("{length} bytes at {at} are outside of the shared memory")]
    Position {
        /// Length of the part, bytes.
        length: usize,
        /// Position of its first byte.
        at: u64,
    },
}

/// Returns the prefix and the header of a request.
pub(super) fn encode(request: &Request<'_>) -> Result<Vec<u8>, serde_json::Error> {
    let mut frame = Vec::with_capacity(256);
    frame.extend_from_slice(&MESSAGE_PREFIX);
    frame.extend_from_slice(&[0; 4]);
    serde_json::to_writer(&mut frame, request)?;
    let length = u32::try_from(frame.len() - PREFIX_BYTES).unwrap_or(u32::MAX);
    frame[MESSAGE_PREFIX.len()..PREFIX_BYTES].copy_from_slice(&length.to_le_bytes());
    Ok(frame)
}

/// Returns the length of the header that follows a prefix ([`PREFIX_BYTES`]).
pub(super) fn header_length(prefix: &[u8]) -> Result<usize, FrameError> {
    let Some(length) = prefix.strip_prefix(&MESSAGE_PREFIX).and_then(|rest| <[u8; 4]>::try_from(rest).ok())
    else {
        return Err(FrameError::Prefix(String::from_utf8_lossy(prefix).into_owned()));
    };
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_HEADER_BYTES { Err(FrameError::HeaderLength(length)) } else { Ok(length) }
}
