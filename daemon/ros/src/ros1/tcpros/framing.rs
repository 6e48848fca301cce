//! Frames of TCPROS: a length of four bytes, little-endian, and that many bytes.

use std::mem;

use bytes::buf::Limit;
use bytes::{Buf, BufMut, Bytes, BytesMut};
use thiserror::Error;

use crate::ros1::memory::{MessageLimits, MessageMemory};

/// Length of the prefix of each frame, bytes.
const PREFIX_BYTES: usize = 4;

/// Size of the read buffer while no long frame is expected, bytes.
const READ_BYTES: usize = 64 * 1024;

/// Largest buffer for a frame, as a multiple of the bytes that have arrived. The multiple is large, because the
/// unwritten part of a buffer takes no memory, while each growth may copy the buffer.
const MAX_GROWTH: usize = 16;

/// Error: a frame cannot be received.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FrameError {
    /// The frame is longer than allowed.
    #[error("the peer announces a frame of {length} bytes; the limit is {max}")]
    TooLong {
        /// Announced length, bytes.
        length: usize,
        /// Longest allowed length, bytes.
        max: usize,
    },
    /// The frame and other frames that arrive at the same time exceed the shared limit.
    #[error("no memory for a frame of {length} bytes: all frames that arrive at the same time share a limit")]
    NoMemory {
        /// Announced length, bytes.
        length: usize,
    },
}

/// Splits the bytes that arrive on a connection into frames.
///
/// A complete frame refers to the buffer into which it was read, and is not copied. A long frame is read into a
/// separate buffer.
#[derive(Debug)]
pub struct FrameBuffer {
    bytes: BytesMut,
    limits: MessageLimits,
    /// Memory of a long frame, reserved from its first bytes on.
    memory: MessageMemory,
}

impl FrameBuffer {
    /// Creates a buffer for frames of at most `max_frame_bytes` bytes.
    pub fn new(max_frame_bytes: usize) -> Self {
        let limits = MessageLimits { max_bytes: max_frame_bytes, memory: None };
        Self { bytes: BytesMut::new(), limits, memory: MessageMemory::default() }
    }

    /// Changes the limits of frames that are not complete.
    pub(in crate::ros1) fn set_limits(&mut self, limits: &MessageLimits) {
        self.limits.clone_from(limits);
    }

    /// Returns the length of the frame that has begun, without its prefix.
    fn frame_length(&self) -> Option<usize> {
        let prefix = self.bytes.get(..PREFIX_BYTES)?;
        let length = u32::from_le_bytes(prefix.try_into().unwrap_or_default());
        Some(usize::try_from(length).unwrap_or(usize::MAX))
    }

    /// Returns the buffer for the next bytes, with space for at least one byte.
    ///
    /// # Errors
    /// If there is no memory for more of a long frame. The connection must then be closed.
    pub fn input(&mut self) -> Result<Limit<&mut BytesMut>, FrameError> {
        let length = self.frame_length().unwrap_or(0).min(self.limits.max_bytes);
        let (arrived_bytes, frame_bytes) = (self.bytes.len(), PREFIX_BYTES + length);
        let missing = frame_bytes.saturating_sub(arrived_bytes).max(1);
        if self.bytes.capacity() - arrived_bytes < missing.min(READ_BYTES) {
            // The buffer of a long frame has no space for the next frame, so the two do not share memory.
            let growth = (arrived_bytes * MAX_GROWTH).max(READ_BYTES);
            self.bytes.reserve(missing.clamp(READ_BYTES, growth));
        }
        let mut room = self.bytes.capacity() - arrived_bytes;
        if frame_bytes > READ_BYTES {
            // At most twice the arrived bytes, or `READ_BYTES` if that is more, are reserved in the shared limit. A
            // long announced length thus takes no memory from other connections.
            let reserved_bytes = frame_bytes.min((2 * arrived_bytes).max(READ_BYTES));
            if !self.memory.grow(reserved_bytes, self.limits.memory.as_ref()) {
                return Err(FrameError::NoMemory { length });
            }
            room = room.min(reserved_bytes - arrived_bytes);
        }
        Ok((&mut self.bytes).limit(room))
    }

    /// Returns the next frame without its length, and its memory, if the frame is complete.
    ///
    /// # Errors
    /// If the next frame is longer than allowed, or there is no memory for it. The connection must then be closed.
    pub fn next_frame(&mut self) -> Result<Option<(Bytes, MessageMemory)>, FrameError> {
        let Some(length) = self.frame_length() else { return Ok(None) };
        if length > self.limits.max_bytes {
            return Err(FrameError::TooLong { length, max: self.limits.max_bytes });
        }
        if self.bytes.len() < PREFIX_BYTES + length {
            return Ok(None);
        }
        let mut memory = mem::take(&mut self.memory);
        if !memory.grow(length, self.limits.memory.as_ref()) {
            return Err(FrameError::NoMemory { length });
        }
        self.bytes.advance(PREFIX_BYTES);
        Ok(Some((self.bytes.split_to(length).freeze(), memory)))
    }

    /// Returns whether a frame has begun and is not complete. The caller must have taken all complete frames with
    /// [`next_frame`](Self::next_frame) before.
    pub fn has_partial_frame(&self) -> bool {
        !self.bytes.is_empty()
    }
}
