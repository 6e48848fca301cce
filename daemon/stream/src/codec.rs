//! Encoding of the event stream's messages and batches: MessagePack with one message per frame, and frames of batches.
//!
//! A batch's frame begins with a byte that no MessagePack value begins with, so that no batch can be read as a message.
//! Numbers are big-endian:
//!
//! | bytes | content |
//! | --- | --- |
//! | 1 | `0xC1`, which MessagePack never uses |
//! | 1 | form of the body: 0 not compressed, 1 compressed with Zstandard |
//! | 16, 16 | host, stream |
//! | 8, 8 | process that sends the batch, number of the batch |
//! | 16, 16 | chain hash of the previous batch, chain hash of this batch |
//! | 8 | number of events in all batches of the spool before this batch |
//! | 4, 4 | number of events, number of bytes of the body before compression |
//! | rest | the body: wire forms of the events, one after the other |
//!
//! A batch's frame that takes long on its link is sent in [parts](encode_part). Other messages can be
//! [compressed](encode_compressed).

mod parts;

use bytes::{Buf, Bytes};
use serde::Serialize;
use serde::de::{Deserialize, DeserializeOwned, IgnoredAny};

use super::{BatchHead, ChainHash, Event, StreamId, ToAgent, ToAggregator};
use peernet_logger::HostId;

pub(super) use self::parts::PART_HEAD_BYTES;
pub use self::parts::{Part, decode_part, encode_part};

/// Maximum length of a message that is read, and of a batch's body, in bytes. Usual batches are far shorter. An event
/// with the largest tree fits.
pub const MAX_MESSAGE_BYTES: usize = 4 * 1024 * 1024;

/// Number of bytes of a batch's frame before its body.
pub(super) const BATCH_HEAD_BYTES: usize = 2 + 16 + 16 + 8 + 8 + 16 + 16 + 8 + 4 + 4;

/// Deepest nesting of MessagePack values. The nodes of a tree add no levels, because a whole tree is one byte string.
// The decoder recurses for each level, and the peer chooses the depth. The limit protects the call stack.
const MAX_NESTING: usize = 32;

/// First byte of all frames that are not plain MessagePack: batches, parts of a batch, and compressed messages. The
/// second byte, the form, distinguishes these kinds of frames.
const FRAME_MARKER: u8 = 0xC1;

/// Form byte of a body that is not compressed.
const PLAIN: u8 = 0;
/// Form byte of a body compressed with Zstandard.
const ZSTD: u8 = 1;
/// Form byte of a part of a batch's frame.
const PART: u8 = 2;
/// Form byte of a compressed message. Four bytes with the length of the uncompressed message follow, and then the
/// compressed message.
const COMPRESSED: u8 = 3;

/// Fastest of the usual levels of Zstandard. It compresses events to about a third of their length; level 3 compresses
/// only a little more.
const ZSTD_LEVEL: i32 = 1;

/// Maximum number of events for which memory is reserved before the events are decoded. The number in the head may be
/// larger, because an untrusted peer states it.
const MAX_RESERVED_EVENTS: usize = 4096;

/// Reason why bytes are not a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// The message is longer than the limit.
    #[error("a message of {0} bytes is longer than the limit of {MAX_MESSAGE_BYTES}")]
    TooLong(usize),
    /// The bytes are another kind of message, or of another version.
    #[error("the message cannot be read: {0}")]
    Malformed(String),
    /// Bytes follow the message.
    #[error("{0} bytes follow the message")]
    Trailing(usize),
    /// The body does not match the chain hash of its batch.
    #[error("batch {0} does not match its hash: it was damaged in the spool or in transit")]
    Damaged(u64),
}

/// A message that is sent as a frame: [`ToAggregator`] or [`ToAgent`].
pub trait Message: Serialize + DeserializeOwned {}

impl Message for ToAggregator {}
impl Message for ToAgent {}

/// Returns the frame of a message.
pub fn encode(message: &impl Message) -> Vec<u8> {
    let mut frame = Vec::with_capacity(256);
    encode_into(&mut frame, message);
    frame
}

/// Returns the frame of a message for a slow link. The frame is compressed if this makes it shorter.
pub fn encode_compressed(message: &impl Message) -> Vec<u8> {
    let plain = encode(message);
    let (Ok(length), Ok(compressed)) = (u32::try_from(plain.len()), zstd::bulk::compress(&plain, ZSTD_LEVEL))
    else {
        return plain;
    };
    let frame = [&[FRAME_MARKER, COMPRESSED][..], &length.to_be_bytes(), &compressed].concat();
    // A short message can grow when compressed.
    if frame.len() < plain.len() { frame } else { plain }
}

/// Decompresses the message in a frame that [`encode_compressed`] made.
fn decompress_message(frame: &[u8]) -> Result<Vec<u8>, CodecError> {
    let fields = frame
        .split_first_chunk()
        .map(|(length, compressed)| (u32::from_be_bytes(*length) as usize, compressed));
    let Some((length, compressed)) = fields else {
        return Err(CodecError::Malformed("the compressed message states no length".into()));
    };
    if length > MAX_MESSAGE_BYTES {
        return Err(CodecError::TooLong(length));
    }
    // The output is limited to the stated length, which is within the limit.
    zstd::bulk::decompress(compressed, length).map_err(|error| CodecError::Malformed(error.to_string()))
}

/// Appends the wire form of a value.
pub(super) fn encode_into(out: &mut Vec<u8>, data: &impl Serialize) {
    rmp_serde::encode::write(out, data).expect("serialising to memory does not fail");
}

/// Reads a frame from an untrusted peer.
///
/// # Errors
/// If the frame is not exactly one message of this kind within the limits.
pub fn decode<M: Message>(frame: &[u8]) -> Result<M, CodecError> {
    if frame.len() > MAX_MESSAGE_BYTES {
        return Err(CodecError::TooLong(frame.len()));
    }
    if let Some(compressed) = frame.strip_prefix(&[FRAME_MARKER, COMPRESSED]) {
        return decode_plain(&decompress_message(compressed)?);
    }
    decode_plain(frame)
}

fn decode_plain<M: Message>(frame: &[u8]) -> Result<M, CodecError> {
    let mut reader = rmp_serde::Deserializer::new(frame);
    reader.set_max_depth(MAX_NESTING);
    let message = M::deserialize(&mut reader).map_err(|error| malformed_error(&error))?;
    match reader.get_ref().len() {
        0 => Ok(message),
        remaining => Err(CodecError::Trailing(remaining)),
    }
}

/// Returns the frame of a batch of encoded events. The body is compressed if `compress` is `true` and compression makes
/// the body shorter.
pub fn encode_batch(head: &BatchHead, body: &[u8], compress: bool) -> Vec<u8> {
    let compressed = compress.then(|| zstd::bulk::compress(body, ZSTD_LEVEL).ok()).flatten();
    let (form, sent_body) = match &compressed {
        Some(compressed) if compressed.len() < body.len() => (ZSTD, compressed.as_slice()),
        _ => (PLAIN, body),
    };
    let mut frame = Vec::with_capacity(BATCH_HEAD_BYTES + sent_body.len());
    frame.extend([FRAME_MARKER, form]);
    frame.extend(head.host.as_bytes());
    frame.extend(head.stream.as_bytes());
    frame.extend(head.process.to_be_bytes());
    frame.extend(head.number.to_be_bytes());
    frame.extend(head.previous_chain.as_bytes());
    frame.extend(head.chain.as_bytes());
    frame.extend(head.events_before.to_be_bytes());
    frame.extend(head.events.to_be_bytes());
    // In place of a length above the largest `u32`, the largest `u32` is written. A reader refuses the body, because
    // this number is above `MAX_MESSAGE_BYTES`.
    frame.extend(u32::try_from(body.len()).unwrap_or(u32::MAX).to_be_bytes());
    frame.extend(sent_body);
    frame
}

/// Returns the head of a batch's frame; `None` for any other message. The body is not checked: a batch that
/// [`decode_batch_body`] or [`decode_events`] refuses can still be identified, quarantined and skipped.
pub fn decode_batch_head(frame: &[u8]) -> Option<BatchHead> {
    read_head(frame).map(|head| head.batch)
}

/// Returns the wire form of a batch's events from its frame, decompressed and checked against the batch's chain hash.
///
/// # Errors
/// If the frame does not contain a batch, or its body is longer than [`MAX_MESSAGE_BYTES`] or does not match the chain
/// hash.
pub fn decode_batch_body(mut frame: Bytes) -> Result<Bytes, CodecError> {
    let Some(Head { form, batch, length }) = read_head(&frame) else {
        return Err(CodecError::Malformed("the frame is not a batch".into()));
    };
    if length > MAX_MESSAGE_BYTES {
        return Err(CodecError::TooLong(length));
    }
    frame.advance(BATCH_HEAD_BYTES);
    let body = match form {
        PLAIN => frame,
        ZSTD => {
            // The output is limited to the length in the head, which is within the limit.
            let body =
                zstd::bulk::decompress(&frame, length).map_err(|_| CodecError::Damaged(batch.number))?;
            Bytes::from(body)
        }
        other => return Err(CodecError::Malformed(format!("the form {other} of the body is unknown"))),
    };
    // The chain hash covers the body and, through the previous chain hash, all batches before this batch. The receiver
    // compares the previous chain hash with the last stored batch, and thus detects a batch of a copied spool.
    if body.len() != length || batch.previous_chain.next(batch.events, &body) != batch.chain {
        return Err(CodecError::Damaged(batch.number));
    }
    Ok(body)
}

/// Reads the events of a batch's body.
///
/// # Errors
/// If the body is not exactly `count` events.
pub fn decode_events(body: &[u8], count: u32) -> Result<Vec<Event>, CodecError> {
    let count = count as usize;
    // Every event takes at least one byte.
    if count > body.len() {
        return Err(CodecError::Malformed(format!("{} bytes cannot hold {count} events", body.len())));
    }
    let mut events = Vec::with_capacity(count.min(MAX_RESERVED_EVENTS));
    // The reader borrows trees from the input and does not copy their bytes.
    let mut reader = rmp_serde::Deserializer::from_read_ref(body);
    reader.set_max_depth(MAX_NESTING);
    for _ in 0..count {
        events.push(Event::deserialize(&mut reader).map_err(|error| malformed_error(&error))?);
    }
    match IgnoredAny::deserialize(&mut reader) {
        // The body ends here: no first byte of a further value follows.
        Err(rmp_serde::decode::Error::InvalidMarkerRead(_)) => Ok(events),
        _ => Err(CodecError::Malformed(format!("bytes follow the {count} events of the batch"))),
    }
}

/// Fields of a batch's frame before the body.
struct Head {
    form: u8,
    batch: BatchHead,
    /// Length of the body before compression, bytes.
    length: usize,
}

fn read_head(frame: &[u8]) -> Option<Head> {
    let rest = frame.strip_prefix(&[FRAME_MARKER])?;
    let (&[form], rest) = rest.split_first_chunk()?;
    // These forms have other fields after the second byte.
    if form == PART || form == COMPRESSED {
        return None;
    }
    let (&host, rest) = rest.split_first_chunk()?;
    let (&stream, rest) = rest.split_first_chunk()?;
    let (&process, rest) = rest.split_first_chunk()?;
    let (&number, rest) = rest.split_first_chunk()?;
    let (&previous_chain, rest) = rest.split_first_chunk()?;
    let (&chain, rest) = rest.split_first_chunk()?;
    let (&events_before, rest) = rest.split_first_chunk()?;
    let (&events, rest) = rest.split_first_chunk()?;
    let (&length, _) = rest.split_first_chunk()?;
    let batch = BatchHead {
        host: HostId::from_bytes(host),
        stream: StreamId::from_bytes(stream),
        process: u64::from_be_bytes(process),
        number: u64::from_be_bytes(number),
        previous_chain: ChainHash::from_bytes(previous_chain),
        chain: ChainHash::from_bytes(chain),
        events: u32::from_be_bytes(events),
        events_before: u64::from_be_bytes(events_before),
    };
    Some(Head { form, batch, length: u32::from_be_bytes(length) as usize })
}

fn malformed_error(error: &rmp_serde::decode::Error) -> CodecError {
    CodecError::Malformed(error.to_string())
}

#[cfg(test)]
mod fixtures;
#[cfg(test)]
mod tests;
