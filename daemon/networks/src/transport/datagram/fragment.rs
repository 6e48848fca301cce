//! Splits a message of several frames into fragments of equal length.

use bytes::{Buf, Bytes};
use peernet_clock::MonoTime;

use crate::transport::Frames;

/// Maximum number of frames of a message.
const MAX_FRAMES: usize = 1_024;

/// Error: a message cannot be sent in fragments.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum UnsendableMessage {
    #[error("a message of more than 4 GiB cannot be sent in datagrams")]
    TooLong,
    #[error("a message of more than {MAX_FRAMES} frames cannot be sent in datagrams")]
    TooManyFrames,
}

/// Error: bytes do not form a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the lengths of the frames do not add up to the length of the message")]
pub(crate) struct InvalidMessage;

/// Returns the number of fragments of a message of `total_bytes` bytes, if each fragment has `stride` bytes. The last
/// fragment may be shorter.
pub(crate) fn fragment_count(total_bytes: u32, stride: u16) -> u32 {
    total_bytes.div_ceil(u32::from(stride.max(1)))
}

/// A message that is being sent. Its wire form is the number of frames (16 bits), their lengths (32 bits each), and the
/// frames.
#[derive(Debug)]
pub(crate) struct OutgoingMessage {
    pub(crate) sequence: u64,
    /// Tag in its wire form: the sender's number for the message, plus one; 0 for none.
    pub(crate) tag: u64,
    /// Length of the wire form. Bytes.
    pub(crate) total_bytes: u32,
    /// CRC-32 of the wire form.
    pub(crate) checksum: u32,
    pub(crate) deadline: Option<MonoTime>,
    /// The header (number and lengths of the frames) and the frames: of each, the part that has not been taken yet.
    pieces: Vec<Bytes>,
    /// Index of the first piece that is not used up.
    first_unused: usize,
    /// Number of bytes of the wire form that were taken.
    pub(crate) offset: u32,
}

impl OutgoingMessage {
    /// Prepares a message.
    ///
    /// # Errors
    /// If the message has too many frames or bytes.
    pub(crate) fn new(
        frames: Frames,
        sequence: u64,
        tag: u64,
        deadline: Option<MonoTime>,
    ) -> Result<Self, UnsendableMessage> {
        let count = u16::try_from(frames.len()).ok().filter(|count| usize::from(*count) <= MAX_FRAMES);
        let mut header = count.ok_or(UnsendableMessage::TooManyFrames)?.to_be_bytes().to_vec();
        for frame in &frames {
            let length = u32::try_from(frame.len()).map_err(|_| UnsendableMessage::TooLong)?;
            header.extend(length.to_be_bytes());
        }
        let mut pieces = Vec::with_capacity(frames.len() + 1);
        pieces.push(Bytes::from(header));
        pieces.extend(frames);
        let bytes: u64 = pieces.iter().map(|piece| piece.len() as u64).sum();
        let total_bytes = u32::try_from(bytes).map_err(|_| UnsendableMessage::TooLong)?;
        let mut checksum = crc32fast::Hasher::new();
        pieces.iter().for_each(|piece| checksum.update(piece));
        Ok(Self {
            sequence,
            tag,
            total_bytes,
            checksum: checksum.finalize(),
            deadline,
            pieces,
            first_unused: 0,
            offset: 0,
        })
    }

    /// Returns whether all bytes were taken.
    pub(crate) const fn is_done(&self) -> bool {
        self.offset >= self.total_bytes
    }

    /// Returns the number of bytes that were not taken yet.
    pub(crate) const fn remaining(&self) -> u32 {
        self.total_bytes - self.offset
    }

    /// Appends at most `max_bytes` of the next bytes to `out`. Returns their offset and number.
    pub(crate) fn take(&mut self, max_bytes: u16, out: &mut Vec<u8>) -> (u32, u16) {
        let (offset, mut bytes_to_take) = (self.offset, usize::from(max_bytes));
        while bytes_to_take > 0
            && let Some(piece) = self.pieces.get_mut(self.first_unused)
        {
            let count = piece.len().min(bytes_to_take);
            out.extend_from_slice(&piece[..count]);
            piece.advance(count);
            bytes_to_take -= count;
            if piece.is_empty() {
                // The memory of a sent piece is freed before the whole message has been sent.
                *piece = Bytes::new();
                self.first_unused += 1;
            }
        }
        let fragment_bytes = max_bytes - bytes_to_take as u16;
        self.offset += u32::from(fragment_bytes);
        (offset, fragment_bytes)
    }
}

/// Returns the frames of a whole message.
///
/// # Errors
/// If the lengths of the frames do not add up to the length of the message.
pub(crate) fn split_frames(mut message: Bytes) -> Result<Frames, InvalidMessage> {
    let count = usize::from(message.try_get_u16().map_err(|_| InvalidMessage)?);
    if count > MAX_FRAMES || message.len() < 4 * count {
        return Err(InvalidMessage);
    }
    let mut lengths = message.split_to(4 * count);
    let mut frames = Vec::with_capacity(count);
    while let Ok(length) = lengths.try_get_u32() {
        let length = usize::try_from(length).map_err(|_| InvalidMessage)?;
        if message.len() < length {
            return Err(InvalidMessage);
        }
        frames.push(message.split_to(length));
    }
    if message.is_empty() { Ok(frames) } else { Err(InvalidMessage) }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn message_of_any_frames_is_split_and_joined(
            sizes in proptest::collection::vec(0_usize..3_000, 0..8),
            stride in 1_u16..2_000,
        ) {
            let frames: Frames = sizes.iter().map(|size| Bytes::from(vec![*size as u8; *size])).collect();
            let mut message = OutgoingMessage::new(frames.clone(), 0, 0, None).expect("the message is small");
            let (mut joined, mut fragments) = (Vec::new(), 0);
            while !message.is_done() {
                let (offset, fragment_bytes) = message.take(stride, &mut joined);
                prop_assert_eq!(offset as usize + usize::from(fragment_bytes), joined.len());
                prop_assert!(fragment_bytes == stride || message.is_done());
                fragments += 1;
            }
            prop_assert_eq!(fragments, fragment_count(message.total_bytes, stride));
            prop_assert_eq!(crc32fast::hash(&joined), message.checksum);
            prop_assert_eq!(split_frames(joined.into()), Ok(frames));
        }

        #[test]
        fn any_bytes_are_split_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            let _ = split_frames(bytes.into());
        }
    }
}
