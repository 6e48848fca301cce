//! What is said over the pipes: a mark, the length of a header, the header as JSON, and the bytes of those parts that
//! are not in the shared memory.

use std::os::fd::RawFd;

use peernet_sample::{Description, Part};
use serde::{Deserialize, Serialize};

use super::{About, Images, Role, Stage};
use crate::text::words;

/// What every frame begins with, so that anything else on the pipe is noticed.
pub(super) const MARK: [u8; 4] = *b"PN1\n";
/// Bytes before the header: the mark and the header's length.
pub(super) const PREFIX: usize = 8;
/// Longest header, in bytes.
pub(super) const MAX_HEADER: usize = 1 << 20;
/// Most bytes of all parts of a value: 1 GiB.
pub(super) const MAX_BYTES: u64 = 1 << 30;
/// The media type of a pickled object; the parts after it are its buffers (pickle protocol 5, PEP 574).
pub const PICKLE: &str = "application/x-python-pickle";

/// What is asked of the worker.
#[derive(Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Request<'a> {
    /// Make the object. `window` is the number of the inherited file whose memory is shared.
    Start { module: &'a str, path: &'a str, role: Role, pickle: bool, images: Images, window: RawFd },
    /// Call it with the parts that follow.
    Call { parts: Vec<PartHead> },
}

/// What it answers.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Reply {
    /// The object is there.
    Ready(About),
    /// The value that it returned, and the stages with their stamps.
    Value { parts: Vec<PartHead>, stages: Vec<(Stage, i64, i64)> },
    /// A sensor has no more.
    Over { stages: Vec<(Stage, i64, i64)> },
    /// The user's code raised an exception.
    Raised {
        #[serde(deserialize_with = "words")]
        text: String,
        stages: Vec<(Stage, i64, i64)>,
    },
    /// A value cannot cross.
    Refused {
        #[serde(deserialize_with = "words")]
        text: String,
        stages: Vec<(Stage, i64, i64)>,
    },
}

/// A part without its bytes.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct PartHead {
    pub(super) description: Description,
    pub(super) length: u64,
    /// Where they lie in the shared memory; otherwise they follow in the pipe.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) at: Option<u64>,
}

impl PartHead {
    pub(super) fn of(part: &Part, at: Option<u64>) -> Self {
        Self { description: part.description.clone(), length: part.bytes.len() as u64, at }
    }
}

/// What is wrong with a message of the process.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// It does not begin with the mark.
    #[error("a message begins with {0:?}")]
    Mark(String),
    /// Its header is longer than any is.
    #[error("a header has {0} bytes; at most {MAX_HEADER}")]
    HeaderLength(usize),
    /// Its header cannot be read or written.
    #[error(transparent)]
    Header(#[from] serde_json::Error),
    /// Its parts are longer than any value is.
    #[error("a value has more than {MAX_BYTES} bytes")]
    ValueLength,
    /// It says a second time that it is ready.
    #[error("it says twice that it is ready")]
    ReadyTwice,
    /// A part does not lie where the header says.
    #[error("{length} bytes at {at} are not in the shared memory")]
    Position {
        /// Bytes of the part.
        length: usize,
        /// Where they are to begin.
        at: u64,
    },
}

/// Mark, length and header of a request.
pub(super) fn encode(request: &Request<'_>) -> Result<Vec<u8>, serde_json::Error> {
    let mut frame = Vec::with_capacity(256);
    frame.extend_from_slice(&MARK);
    frame.extend_from_slice(&[0; 4]);
    serde_json::to_writer(&mut frame, request)?;
    let length = u32::try_from(frame.len() - PREFIX).unwrap_or(u32::MAX);
    frame[MARK.len()..PREFIX].copy_from_slice(&length.to_le_bytes());
    Ok(frame)
}

/// Returns the length of the header that follows a prefix.
pub(super) fn header_length(prefix: &[u8]) -> Result<usize, FrameError> {
    let Some(length) = prefix.strip_prefix(&MARK).and_then(|rest| <[u8; 4]>::try_from(rest).ok()) else {
        return Err(FrameError::Mark(String::from_utf8_lossy(prefix).into_owned()));
    };
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_HEADER { Err(FrameError::HeaderLength(length)) } else { Ok(length) }
}
