//! Splits the bytes of one connection into ZMTP frames, within limits. No I/O.
//!
//! The codec of the library only ever gets whole frames: everything unfinished is held, and counted, here.

use std::sync::Arc;

use bytes::buf::Limit;
use bytes::{BufMut, Bytes};

use super::limits::{FRAME_OVERHEAD_BYTES, MAX_HANDSHAKE_BYTES, MAX_UNADMITTED_BYTES};
use super::rejections::Rejection;
use crate::transport::memory::{MemoryBudget, Reservation};

/// Bytes of the greeting that a ZMTP connection begins with (RFC 23).
const GREETING_BYTES: usize = 64;

/// Bits of a frame's first byte (RFC 23).
const MORE: u8 = 0x01;
const LONG: u8 = 0x02;
const COMMAND: u8 = 0x04;

/// Bytes reserved at once for a frame that has just begun, as far as it claims so many.
const FIRST_BYTES_UNADMITTED: usize = 4 * 1024;
const FIRST_BYTES: usize = 64 * 1024;

/// The same on a connection that already sent frames of this length: a stream of images needs no growing buffers.
const MOST_FIRST_BYTES: usize = 2 * 1024 * 1024;

/// Rests of frames from this length on are read from the kernel straight into the frame's own buffer.
const DIRECT_READ_BYTES: usize = 8 * 1024;

/// The most that one such read takes: while the kernel copies more, it takes in nothing, and the sender waits.
const MOST_DIRECT_READ_BYTES: usize = 64 * 1024;

/// What a connection may send at the moment.
#[derive(Debug)]
pub(super) struct Allowance {
    pub(super) stage: Stage,
    /// Largest message of an admitted connection.
    pub(super) max_message_bytes: usize,
    pub(super) unadmitted: Arc<MemoryBudget>,
    pub(super) admitted: Arc<MemoryBudget>,
}

/// How far a connection has come, as far as it matters for what it may send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    Handshake,
    Unadmitted,
    Admitted,
}

/// Why the connection must be closed.
pub(super) type Violation = (Rejection, String);

/// Bytes for the codec.
#[derive(Debug)]
pub(super) struct Piece {
    pub(super) bytes: Bytes,
    /// Present when a message ends with these bytes: the memory that it takes.
    pub(super) message: Option<Reservation>,
}

/// The frames of one connection.
#[derive(Debug)]
pub(super) struct Framer {
    state: State,
    /// Bytes of the unfinished message's frames that are whole.
    finished_bytes: usize,
    /// Covers the unfinished message, its unfinished frame included.
    reserved: Reservation,
    /// Largest frame that was ever completed here.
    largest_frame: usize,
}

#[derive(Debug)]
enum State {
    /// So many bytes of the greeting are missing.
    Greeting(usize),
    Header {
        bytes: [u8; 9],
        have: usize,
    },
    Body {
        flags: u8,
        buffer: Vec<u8>,
        length: usize,
    },
}

const NO_HEADER: State = State::Header { bytes: [0; 9], have: 0 };

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

    /// Where the rest of a long frame is to be read to, if one is expected. [`filled`](Self::filled) follows.
    ///
    /// # Errors
    /// When there is no memory for it.
    pub(super) fn direct_buffer(
        &mut self,
        allowance: &Allowance,
    ) -> Result<Option<Limit<&mut Vec<u8>>>, Violation> {
        let State::Body { buffer, length, .. } = &mut self.state else { return Ok(None) };
        if *length - buffer.len() < DIRECT_READ_BYTES {
            return Ok(None);
        }
        if buffer.len() == buffer.capacity() {
            let capacity = (*length).min(buffer.len() * 2);
            grow(buffer, capacity, self.finished_bytes, &mut self.reserved, allowance)?;
        }
        let room = (*length).min(buffer.capacity()) - buffer.len();
        Ok(Some(buffer.limit(room.min(MOST_DIRECT_READ_BYTES))))
    }

    /// Bytes were read into the [direct buffer](Self::direct_buffer).
    pub(super) fn filled(&mut self, allowance: &Allowance, out: &mut Vec<Piece>) -> Result<(), Violation> {
        self.complete_body(allowance, out)
    }

    /// Bytes were read.
    ///
    /// # Errors
    /// When they are more than the connection may send now.
    pub(super) fn input(
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
                        self.state = NO_HEADER;
                    }
                    out.push(Piece { bytes: Bytes::copy_from_slice(greeting), message: None });
                    chunk = rest;
                }
                State::Header { have: 0, .. } if is_whole_frame(chunk) => {
                    let (flags, length) = self.check(chunk, allowance)?;
                    let (frame, rest) = chunk.split_at(header_length(flags) + length);
                    let message = self.complete_frame(flags, length, allowance)?;
                    out.push(Piece { bytes: Bytes::copy_from_slice(frame), message });
                    chunk = rest;
                }
                State::Header { bytes, have } => {
                    let needed = if *have == 0 { header_length(chunk[0]) } else { header_length(bytes[0]) };
                    let (header, rest) = chunk.split_at(chunk.len().min(needed - *have));
                    bytes[*have..*have + header.len()].copy_from_slice(header);
                    *have += header.len();
                    if *have == needed {
                        let header = *bytes;
                        self.begin_body(&header[..needed], allowance, out)?;
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
                    self.complete_body(allowance, out)?;
                }
            }
        }
        Ok(())
    }

    fn begin_body(
        &mut self,
        header: &[u8],
        allowance: &Allowance,
        out: &mut Vec<Piece>,
    ) -> Result<(), Violation> {
        let (flags, length) = self.check(header, allowance)?;
        // The codec checks the flags before anything is reserved.
        out.push(Piece { bytes: Bytes::copy_from_slice(header), message: None });
        let first = match allowance.stage {
            Stage::Admitted => FIRST_BYTES.max(self.largest_frame.min(MOST_FIRST_BYTES)),
            Stage::Handshake | Stage::Unadmitted => FIRST_BYTES_UNADMITTED,
        };
        let mut buffer = Vec::new();
        grow(&mut buffer, length.min(first), self.finished_bytes, &mut self.reserved, allowance)?;
        self.state = State::Body { flags, buffer, length };
        self.complete_body(allowance, out)
    }

    /// Flags and length of a frame, of which at least the header is there, if the connection may send it now.
    fn check(&self, frame: &[u8], allowance: &Allowance) -> Result<(u8, usize), Violation> {
        let (flags, length) = (frame[0], frame_length(frame));
        let size = self.finished_bytes.saturating_add(length).saturating_add(FRAME_OVERHEAD_BYTES);
        match allowance.stage {
            Stage::Handshake if flags & COMMAND != 0 && length > MAX_HANDSHAKE_BYTES => {
                let text = format!("it claims {length} bytes during the handshake");
                return Err((Rejection::Handshake, text));
            }
            Stage::Handshake | Stage::Unadmitted if size > MAX_UNADMITTED_BYTES => {
                let text = format!(
                    "it claims {length} bytes before its hello was accepted; {MAX_UNADMITTED_BYTES} are allowed"
                );
                return Err((Rejection::LargeBeforeHello, text));
            }
            // The codec names the exact limit, with the overhead of each frame.
            Stage::Admitted if length > allowance.max_message_bytes => {
                let text = format!("it claims {length} bytes; {} are allowed", allowance.max_message_bytes);
                return Err((Rejection::TooLarge, text));
            }
            _ => {}
        }
        Ok((flags, length))
    }

    fn complete_body(&mut self, allowance: &Allowance, out: &mut Vec<Piece>) -> Result<(), Violation> {
        let State::Body { flags, buffer, length } = &mut self.state else { return Ok(()) };
        if buffer.len() < *length {
            return Ok(());
        }
        let (flags, bytes) = (*flags, Bytes::from(std::mem::take(buffer)));
        self.largest_frame = self.largest_frame.max(bytes.len());
        self.state = NO_HEADER;
        let message = self.complete_frame(flags, bytes.len(), allowance)?;
        out.push(Piece { bytes, message });
        Ok(())
    }

    /// Counts a frame that is whole. Returns the memory of the message that ends with it.
    fn complete_frame(
        &mut self,
        flags: u8,
        length: usize,
        allowance: &Allowance,
    ) -> Result<Option<Reservation>, Violation> {
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

/// The length that a frame claims, of which at least the header is there.
fn frame_length(frame: &[u8]) -> usize {
    let long = |bytes: &[u8]| bytes.iter().fold(0, |length, byte| length << 8 | u64::from(*byte));
    let claimed = long(&frame[1..header_length(frame[0])]);
    usize::try_from(claimed).unwrap_or(usize::MAX)
}

/// Whether the first frame of a chunk is there as a whole.
fn is_whole_frame(chunk: &[u8]) -> bool {
    let header = header_length(chunk[0]);
    chunk.len() >= header && chunk.len() - header >= frame_length(chunk)
}

const fn header_length(flags: u8) -> usize {
    if flags & LONG == 0 { 2 } else { 9 }
}

/// Makes room for `capacity` bytes of a frame, beside the message's finished frames.
fn grow(
    buffer: &mut Vec<u8>,
    capacity: usize,
    finished_bytes: usize,
    reserved: &mut Reservation,
    allowance: &Allowance,
) -> Result<(), Violation> {
    reserve(reserved, finished_bytes.saturating_add(capacity + FRAME_OVERHEAD_BYTES), allowance)?;
    buffer.try_reserve_exact(capacity - buffer.len()).map_err(|error| {
        (Rejection::NoMemory, format!("no memory for {capacity} bytes of an unfinished frame: {error}"))
    })
}

fn reserve(reserved: &mut Reservation, bytes: usize, allowance: &Allowance) -> Result<(), Violation> {
    let budget = match allowance.stage {
        Stage::Admitted => &allowance.admitted,
        Stage::Handshake | Stage::Unadmitted => &allowance.unadmitted,
    };
    reserved.set(budget, bytes as u64).map_err(|_| {
        let text = format!("unfinished messages fill their budget, which has no room for {bytes} bytes more");
        (Rejection::NoMemory, text)
    })
}

#[cfg(test)]
mod tests;
