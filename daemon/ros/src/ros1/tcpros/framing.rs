//! Frames: a length of four bytes, little-endian, and as many bytes as it says.

use bytes::{Buf, Bytes, BytesMut};
use thiserror::Error;

/// Bytes of the length before each frame.
const PREFIX_BYTES: usize = 4;

/// Room for reading while no long frame is expected.
const READ_BYTES: usize = 64 * 1024;

/// Most room for a frame, as a multiple of the bytes that have arrived of it: a claimed length alone reserves nothing.
const MAX_GROWTH: usize = 16;

/// A frame that is too long.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("the peer announces a frame of {length} bytes; the longest allowed has {max}")]
pub struct FrameError {
    /// Announced length in bytes.
    pub length: usize,
    /// Longest allowed length in bytes.
    pub max: usize,
}

/// Bytes that arrived on a connection, split into frames.
///
/// A frame refers to the bytes as they were read. A long frame is read into a separate buffer.
#[derive(Debug)]
pub struct FrameBuffer {
    bytes: BytesMut,
    max_frame_bytes: usize,
}

impl FrameBuffer {
    /// Creates a buffer for frames of at most `max_frame_bytes` bytes.
    pub fn new(max_frame_bytes: usize) -> Self {
        Self { bytes: BytesMut::new(), max_frame_bytes }
    }

    /// Changes the longest allowed length of the frames that follow.
    pub fn set_max_frame_bytes(&mut self, max_frame_bytes: usize) {
        self.max_frame_bytes = max_frame_bytes;
    }

    /// Returns the length of the frame that has begun.
    fn announced(&self) -> Option<usize> {
        let prefix = self.bytes.get(..PREFIX_BYTES)?;
        let length = u32::from_le_bytes(prefix.try_into().unwrap_or_default());
        Some(usize::try_from(length).unwrap_or(usize::MAX))
    }

    /// Returns the buffer to append what is read next to, with room for it.
    pub fn input(&mut self) -> &mut BytesMut {
        let frame = PREFIX_BYTES + self.announced().unwrap_or(0).min(self.max_frame_bytes);
        let missing = frame.saturating_sub(self.bytes.len()).max(1);
        let room = self.bytes.capacity() - self.bytes.len();
        if room < missing.min(READ_BYTES) {
            // A long frame gets room for itself alone, so that no bytes of the next one share its buffer.
            let growth = (self.bytes.len() * MAX_GROWTH).max(READ_BYTES);
            self.bytes.reserve(missing.clamp(READ_BYTES, growth));
        }
        &mut self.bytes
    }

    /// Returns the next frame, without its length, if it is complete.
    ///
    /// # Errors
    /// The next frame is longer than allowed. The connection cannot go on.
    pub fn next_frame(&mut self) -> Result<Option<Bytes>, FrameError> {
        let Some(length) = self.announced() else { return Ok(None) };
        if length > self.max_frame_bytes {
            return Err(FrameError { length, max: self.max_frame_bytes });
        }
        if self.bytes.len() < PREFIX_BYTES + length {
            return Ok(None);
        }
        self.bytes.advance(PREFIX_BYTES);
        Ok(Some(self.bytes.split_to(length).freeze()))
    }

    /// Returns whether a frame has begun that is not complete.
    pub fn has_partial_frame(&self) -> bool {
        !self.bytes.is_empty()
    }
}
