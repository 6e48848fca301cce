//! Splits the bytes of one connection into ZMTP frames, within limits and without I/O.
//!
//! The codec of the library ([`omq_proto`]) gets the body of a frame when the whole body has arrived. Bytes of
//! unfinished frames are stored and counted here. The buffer of a frame has a limited size at first and grows as bytes
//! arrive, so an announced length alone reserves no more memory than this first size.

use std::sync::Arc;

use bytes::buf::Limit;
use bytes::{BufMut, Bytes};

use super::limits::{FRAME_OVERHEAD_BYTES, MAX_HANDSHAKE_BYTES, MAX_UNADMITTED_BYTES};
use super::rejections::Rejection;
use crate::transport::memory::{MemoryBudget, Reservation};

/// Length of the greeting of a ZMTP connection (RFC 23 of ZeroMQ). Bytes.
const GREETING_BYTES: usize = 64;

/// Bits of a frame's first byte (RFC 23 of ZeroMQ).
const MORE: u8 = 0x01;
const LONG: u8 = 0x02;
const COMMAND: u8 = 0x04;

/// Maximum number of bytes that are reserved at the start of a frame, before and after admission.
const INITIAL_BUFFER_BYTES_UNADMITTED: usize = 4 * 1024;
const INITIAL_BUFFER_BYTES: usize = 64 * 1024;

/// Maximum number of bytes that are reserved at the start of a frame on a connection that has already sent frames of
/// this length. A stream of images then does not need growing buffers.
const MAX_INITIAL_BUFFER_BYTES: usize = 2 * 1024 * 1024;

/// Smallest remainder of a frame that is read from the kernel straight into the frame's buffer. Bytes.
const DIRECT_READ_BYTES: usize = 8 * 1024;

/// Maximum number of bytes of one read into a frame's buffer.
// While the kernel copies to this process, the kernel receives nothing for the connection, and the sender waits.
const MAX_DIRECT_READ_BYTES: usize = 64 * 1024;

/// Limits on what a connection may send at present.
#[derive(Debug)]
pub(super) struct Allowance {
    pub(super) stage: Stage,
    /// Largest message of an admitted connection. Bytes.
    pub(super) max_message_bytes: usize,
    pub(super) unadmitted: Arc<MemoryBudget>,
    pub(super) admitted: Arc<MemoryBudget>,
}

/// Stage of a connection that determines its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    Handshake,
    Unadmitted,
    Admitted,
}

/// Reason why the connection must be closed, and a text for the log.
pub(super) type Violation = (Rejection, String);

/// Bytes that the codec gets in one call.
#[derive(Debug)]
pub(super) struct Piece {
    pub(super) bytes: Bytes,
    /// Reservation of a message's memory, if a message ends with these bytes.
    pub(super) message_memory: Option<Reservation>,
}

/// Splits the bytes of one connection into frames.
#[derive(Debug)]
pub(super) struct Framer {
    state: State,
    /// Bytes of the complete frames of the unfinished message.
    finished_bytes: usize,
    /// Memory of the unfinished message, including its unfinished frame.
    reserved: Reservation,
    /// Length of the largest frame that was completed on this connection.
    largest_frame: usize,
}

#[derive(Debug)]
enum State {
    /// Number of missing bytes of the greeting.
    Greeting(usize),
    /// A frame's header, of which `received` bytes have arrived.
    Header { bytes: [u8; 9], received: usize },
    /// A frame's body of `length` bytes, as far as it has arrived.
    Body { flags: u8, buffer: Vec<u8>, length: usize },
}

const EMPTY_HEADER: State = State::Header { bytes: [0; 9], received: 0 };

impl Framer {
    pub(super) fn new(allowance: &Allowance) -> Self {
        Self {
            state: State::Greeting(GREETING_BYTES),
            finished_bytes: 0,
            reserved: Reservation::empty(&allowance.unadmitted),
            largest_frame: 0,
        }
    }

    #[cfg(test)]
    fn reserved_bytes(&self) -> u64 {
        self.reserved.bytes()
    }

    /// Returns the buffer into which the remainder of a long frame must be read. `None` if no long remainder is
    /// missing. After the read, [`complete_direct_read`](Self::complete_direct_read) must be called.
    ///
    /// # Errors
    /// If there is no memory for the frame.
    pub(super) fn direct_buffer(
        &mut self,
        allowance: &Allowance,
    ) -> Result<Option<Limit<&mut Vec<u8>>>, Violation> {
        let State::Body { buffer, length, .. } = &mut self.state else { return Ok(None) };
        if *length - buffer.len() < DIRECT_READ_BYTES {
            return Ok(None);
        }
        if buffer.len() == buffer.capacity() {
            // A full buffer at most doubles, so an announced length alone takes no memory beyond the initial buffer.
            let capacity = (*length).min(buffer.len() * 2);
            grow(buffer, capacity, self.finished_bytes, &mut self.reserved, allowance)?;
        }
        let room = (*length).min(buffer.capacity()) - buffer.len();
        Ok(Some(buffer.limit(room.min(MAX_DIRECT_READ_BYTES))))
    }

    /// Handles bytes that were read into the [direct buffer](Self::direct_buffer).
    pub(super) fn complete_direct_read(
        &mut self,
        allowance: &Allowance,
        out: &mut Vec<Piece>,
    ) -> Result<(), Violation> {
        self.finish_body_if_complete(allowance, out)
    }

    /// Handles bytes that were read.
    ///
    /// # Errors
    /// If the bytes are more than the connection may send at present.
    pub(super) fn receive(
        &mut self,
        mut chunk: &[u8],
        allowance: &Allowance,
        out: &mut Vec<Piece>,
    ) -> Result<(), Violation> {
        while !chunk.is_empty() {
            match &mut self.state {
                State::Greeting(missing) => {
                    let (greeting, rest) = chunk.split_at(chunk.len().min(*missing));
                    *missing -= greeting.len();
                    if *missing == 0 {
                        self.state = EMPTY_HEADER;
                    }
                    out.push(Piece { bytes: Bytes::copy_from_slice(greeting), message_memory: None });
                    chunk = rest;
                }
                // A frame that has arrived whole needs no buffer of its own.
                State::Header { received: 0, .. } if is_whole_frame(chunk) => {
                    let (flags, length) = self.check_frame(chunk, allowance)?;
                    let (frame, rest) = chunk.split_at(header_length(flags) + length);
                    let message_memory = self.complete_frame(flags, length, allowance)?;
                    out.push(Piece { bytes: Bytes::copy_from_slice(frame), message_memory });
                    chunk = rest;
                }
                State::Header { bytes, received } => {
                    let needed =
                        if *received == 0 { header_length(chunk[0]) } else { header_length(bytes[0]) };
                    let (header, rest) = chunk.split_at(chunk.len().min(needed - *received));
                    bytes[*received..*received + header.len()].copy_from_slice(header);
                    *received += header.len();
                    if *received == needed {
                        let header = *bytes;
                        self.start_body(&header[..needed], allowance, out)?;
                    }
                    chunk = rest;
                }
                State::Body { buffer, length, .. } => {
                    let (body, rest) = chunk.split_at(chunk.len().min(*length - buffer.len()));
                    let needed = buffer.len() + body.len();
                    if needed > buffer.capacity() {
                        let capacity = (*length).min(needed.max(buffer.capacity() * 2));
                        grow(buffer, capacity, self.finished_bytes, &mut self.reserved, allowance)?;
                    }
                    buffer.extend_from_slice(body);
                    chunk = rest;
                    self.finish_body_if_complete(allowance, out)?;
                }
            }
        }
        Ok(())
    }

    fn start_body(
        &mut self,
        header: &[u8],
        allowance: &Allowance,
        out: &mut Vec<Piece>,
    ) -> Result<(), Violation> {
        let (flags, length) = self.check_frame(header, allowance)?;
        // The codec gets the header before the body, so that it can reject the flags before the whole body has arrived.
        out.push(Piece { bytes: Bytes::copy_from_slice(header), message_memory: None });
        let initial = match allowance.stage {
            Stage::Admitted => INITIAL_BUFFER_BYTES.max(self.largest_frame.min(MAX_INITIAL_BUFFER_BYTES)),
            Stage::Handshake | Stage::Unadmitted => INITIAL_BUFFER_BYTES_UNADMITTED,
        };
        let mut buffer = Vec::new();
        grow(&mut buffer, length.min(initial), self.finished_bytes, &mut self.reserved, allowance)?;
        self.state = State::Body { flags, buffer, length };
        self.finish_body_if_complete(allowance, out)
    }

    /// Checks that the connection may send this frame at present. Returns the flags and the length of the frame, whose
    /// header must have arrived.
    ///
    /// # Errors
    /// If the connection must not send such a frame at present.
    fn check_frame(&self, frame: &[u8], allowance: &Allowance) -> Result<(u8, usize), Violation> {
        let (flags, length) = (frame[0], frame_length(frame));
        // The frame counts together with the complete frames of the same message.
        let size = self.finished_bytes.saturating_add(length).saturating_add(FRAME_OVERHEAD_BYTES);
        match allowance.stage {
            Stage::Handshake if flags & COMMAND != 0 && length > MAX_HANDSHAKE_BYTES => {
                let text = format!(
                    "the peer announced a command of {length} bytes during the handshake; {MAX_HANDSHAKE_BYTES} are allowed"
                );
                return Err((Rejection::Handshake, text));
            }
            Stage::Handshake | Stage::Unadmitted if size > MAX_UNADMITTED_BYTES => {
                let text = format!(
                    "the peer announced a message that needs at least {size} bytes of memory before its hello was accepted; {MAX_UNADMITTED_BYTES} are allowed"
                );
                return Err((Rejection::LargeBeforeHello, text));
            }
            // This check covers the length of a single frame. The codec checks the exact limit: the sum over all frames
            // of the message, with their overhead.
            Stage::Admitted if length > allowance.max_message_bytes => {
                let text = format!(
                    "the peer announced a frame of {length} bytes; {} are allowed",
                    allowance.max_message_bytes
                );
                return Err((Rejection::TooLarge, text));
            }
            _ => {}
        }
        Ok((flags, length))
    }

    /// Adds the frame to `out` if its whole body has arrived.
    fn finish_body_if_complete(
        &mut self,
        allowance: &Allowance,
        out: &mut Vec<Piece>,
    ) -> Result<(), Violation> {
        let State::Body { flags, buffer, length } = &mut self.state else { return Ok(()) };
        if buffer.len() < *length {
            return Ok(());
        }
        let (flags, bytes) = (*flags, Bytes::from(std::mem::take(buffer)));
        self.largest_frame = self.largest_frame.max(bytes.len());
        self.state = EMPTY_HEADER;
        let message_memory = self.complete_frame(flags, bytes.len(), allowance)?;
        out.push(Piece { bytes, message_memory });
        Ok(())
    }

    /// Counts a complete frame. Returns the memory of the message if the message ends with this frame.
    fn complete_frame(
        &mut self,
        flags: u8,
        length: usize,
        allowance: &Allowance,
    ) -> Result<Option<Reservation>, Violation> {
        // Commands may stand between the frames of a message, but do not belong to the message.
        if flags & COMMAND == 0 {
            self.finished_bytes = self.finished_bytes.saturating_add(length + FRAME_OVERHEAD_BYTES);
        }
        reserve(&mut self.reserved, self.finished_bytes, allowance)?;
        Ok((flags & (MORE | COMMAND) == 0).then(|| {
            self.finished_bytes = 0;
            self.reserved.take()
        }))
    }
}

/// Returns the length that a frame announces. At least the frame's header must have arrived.
fn frame_length(frame: &[u8]) -> usize {
    let big_endian = |bytes: &[u8]| bytes.iter().fold(0, |length, byte| length << 8 | u64::from(*byte));
    let announced = big_endian(&frame[1..header_length(frame[0])]);
    usize::try_from(announced).unwrap_or(usize::MAX)
}

/// Returns whether the first frame of a chunk is complete.
fn is_whole_frame(chunk: &[u8]) -> bool {
    let header = header_length(chunk[0]);
    chunk.len() >= header && chunk.len() - header >= frame_length(chunk)
}

const fn header_length(flags: u8) -> usize {
    if flags & LONG == 0 { 2 } else { 9 }
}

/// Grows the buffer of a frame to `capacity` bytes and reserves their memory, in addition to the memory of the
/// message's complete frames.
fn grow(
    buffer: &mut Vec<u8>,
    capacity: usize,
    finished_bytes: usize,
    reserved: &mut Reservation,
    allowance: &Allowance,
) -> Result<(), Violation> {
    reserve(reserved, finished_bytes.saturating_add(capacity + FRAME_OVERHEAD_BYTES), allowance)?;
    // The peer chooses the length, so a failed allocation must end the connection and not the process.
    buffer.try_reserve_exact(capacity - buffer.len()).map_err(|error| {
        (Rejection::NoMemory, format!("no memory for {capacity} bytes of an unfinished frame: {error}"))
    })
}

fn reserve(reserved: &mut Reservation, bytes: usize, allowance: &Allowance) -> Result<(), Violation> {
    let budget = match allowance.stage {
        Stage::Admitted => &allowance.admitted,
        Stage::Handshake | Stage::Unadmitted => &allowance.unadmitted,
    };
    reserved.resize(budget, bytes as u64).map_err(|_| {
        let text = format!("cannot reserve {bytes} bytes for an unfinished message: the memory budget of unfinished messages is used up");
        (Rejection::NoMemory, text)
    })
}

#[cfg(test)]
mod tests;
