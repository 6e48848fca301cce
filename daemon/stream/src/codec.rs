//! Messages of the event stream to bytes and back: MessagePack, one message a frame; and the frames of batches.
//!
//! A batch's frame begins with a byte that begins no MessagePack value, so that the two are never taken for one
//! another. Numbers are big-endian:
//!
//! | bytes | what |
//! | --- | --- |
//! | 1 | `0xC1`, which MessagePack never uses |
//! | 1 | form of the body: 0 as it is, 1 compressed with Zstandard |
//! | 16, 16 | host, stream |
//! | 8, 8 | process that sends it, number |
//! | 16, 16 | chain of the batch before, chain of this one |
//! | 8 | events in all batches of the spool before this one |
//! | 4, 4 | events, bytes of the body when it is not compressed |
//! | rest | the body: wire forms of the events, one after the other |
//!
//! A batch's frame that is long for its way is sent in [parts](part_frame); other messages can be
//! [compressed](encode_packed).

mod parts;

use bytes::{Buf, Bytes};
use serde::Serialize;
use serde::de::{Deserialize, DeserializeOwned, IgnoredAny};

use super::{BatchHead, Chain, Event, StreamId, ToAgent, ToAggregator};
use peernet_logger::HostId;

pub(super) use self::parts::PART_HEAD_BYTES;
pub use self::parts::{Part, part, part_frame};

/// Longest message that is read, and longest body of a batch. A batch is cut far below it; one tree of the largest
/// size fits.
pub const MAX_MESSAGE_BYTES: usize = 4 * 1024 * 1024;

/// Bytes of a batch's frame before its body.
pub(super) const BATCH_HEAD_BYTES: usize = 2 + 16 + 16 + 8 + 8 + 16 + 16 + 8 + 4 + 4;

/// Deepest nesting of values (not of nodes: a tree is one byte string).
const MAX_NESTING: usize = 32;

/// First byte of a batch's frame.
const BATCH: u8 = 0xC1;

/// Forms of a batch's body.
const PLAIN: u8 = 0;
const ZSTD: u8 = 1;
/// In the place of a form: this is a part of a batch's frame.
const PART: u8 = 2;
/// In the place of a form: behind it are four bytes with the length of a message, and the message compressed.
const PACKED: u8 = 3;

/// The fastest of zstd's usual levels: events shrink to about a third with it, and level 3 gains little more.
const ZSTD_LEVEL: i32 = 1;

/// Places made ready for events at once: the number comes from anyone.
const EXPECTED_EVENTS: usize = 4096;

/// Bytes that are no message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// Longer than anything that is read.
    #[error("a message of {0} bytes is longer than the limit of {MAX_MESSAGE_BYTES}")]
    TooLong(usize),
    /// Not this kind of message, or not of this version.
    #[error("the message cannot be read: {0}")]
    Malformed(String),
    /// Something follows.
    #[error("{0} bytes follow the message")]
    Trailing(usize),
    /// The body is not what the batch's chain was computed from.
    #[error("batch {0} does not match its hash: it was damaged in the spool or on its way")]
    Damaged(u64),
}

/// What travels as a frame: [`ToAggregator`] and [`ToAgent`].
pub trait Message: Serialize + DeserializeOwned {}

impl Message for ToAggregator {}
impl Message for ToAgent {}

/// The frame of a message.
pub fn encode(message: &impl Message) -> Vec<u8> {
    let mut frame = Vec::with_capacity(256);
    append(&mut frame, message);
    frame
}

/// The frame of a message for a slow link, compressed where that makes it shorter.
pub fn encode_packed(message: &impl Message) -> Vec<u8> {
    let plain = encode(message);
    let (Ok(length), Ok(packed)) = (u32::try_from(plain.len()), zstd::bulk::compress(&plain, ZSTD_LEVEL))
    else {
        return plain;
    };
    let frame = [&[BATCH, PACKED][..], &length.to_be_bytes(), &packed].concat();
    if frame.len() < plain.len() { frame } else { plain }
}

/// The message in a frame that [`encode_packed`] made.
fn unpack(frame: &[u8]) -> Result<Vec<u8>, CodecError> {
    let read =
        frame.split_first_chunk().map(|(length, packed)| (u32::from_be_bytes(*length) as usize, packed));
    let Some((length, packed)) = read else {
        return Err(CodecError::Malformed("a compressed message without a length".into()));
    };
    if length > MAX_MESSAGE_BYTES {
        return Err(CodecError::TooLong(length));
    }
    // Never more than it says.
    zstd::bulk::decompress(packed, length).map_err(|error| CodecError::Malformed(error.to_string()))
}

/// Appends the wire form of plain data.
pub(super) fn append(out: &mut Vec<u8>, data: &impl Serialize) {
    rmp_serde::encode::write(out, data).expect("plain data written to memory always serialises");
}

/// Reads a frame that anyone may have sent.
///
/// # Errors
/// When it is not exactly one message of this kind within the limits.
pub fn decode<M: Message>(frame: &[u8]) -> Result<M, CodecError> {
    if frame.len() > MAX_MESSAGE_BYTES {
        return Err(CodecError::TooLong(frame.len()));
    }
    if let Some(packed) = frame.strip_prefix(&[BATCH, PACKED]) {
        return read(&unpack(packed)?);
    }
    read(frame)
}

fn read<M: Message>(frame: &[u8]) -> Result<M, CodecError> {
    let mut reader = rmp_serde::Deserializer::new(frame);
    reader.set_max_depth(MAX_NESTING);
    let message = M::deserialize(&mut reader).map_err(|error| malformed(&error))?;
    match reader.get_ref().len() {
        0 => Ok(message),
        more => Err(CodecError::Trailing(more)),
    }
}

/// The frame of a batch of events that are encoded already. It is compressed when that is wished and makes it shorter.
pub fn batch_frame(head: &BatchHead, body: &[u8], compress: bool) -> Vec<u8> {
    let packed = compress.then(|| zstd::bulk::compress(body, ZSTD_LEVEL).ok()).flatten();
    let (form, sent) = match &packed {
        Some(packed) if packed.len() < body.len() => (ZSTD, packed.as_slice()),
        _ => (PLAIN, body),
    };
    let mut frame = Vec::with_capacity(BATCH_HEAD_BYTES + sent.len());
    frame.extend([BATCH, form]);
    frame.extend(head.host.as_bytes());
    frame.extend(head.stream.as_bytes());
    frame.extend(head.process.to_be_bytes());
    frame.extend(head.number.to_be_bytes());
    frame.extend(head.before.as_bytes());
    frame.extend(head.chain.as_bytes());
    frame.extend(head.events_before.to_be_bytes());
    frame.extend(head.events.to_be_bytes());
    // A longer body than a u32 can say is refused by whoever reads it.
    frame.extend(u32::try_from(body.len()).unwrap_or(u32::MAX).to_be_bytes());
    frame.extend(sent);
    frame
}

/// The head of a batch's frame; `None` for any other message. The body is not looked at: a batch that [`batch_body`]
/// or [`events`] refuses can still be named, put aside and left behind.
pub fn batch_head(frame: &[u8]) -> Option<BatchHead> {
    read_head(frame).map(|head| head.batch)
}

/// The events of a batch's frame in wire form, decompressed and compared with the batch's chain.
///
/// # Errors
/// When the frame is no batch's, its body is longer than [`MAX_MESSAGE_BYTES`], or not the one the chain was computed
/// from.
pub fn batch_body(mut frame: Bytes) -> Result<Bytes, CodecError> {
    let Some(Head { form, batch, length }) = read_head(&frame) else {
        return Err(CodecError::Malformed("it is no batch".into()));
    };
    if length > MAX_MESSAGE_BYTES {
        return Err(CodecError::TooLong(length));
    }
    frame.advance(BATCH_HEAD_BYTES);
    let body = match form {
        PLAIN => frame,
        ZSTD => {
            // Never more than the head says, which is within the limit.
            let body =
                zstd::bulk::decompress(&frame, length).map_err(|_| CodecError::Damaged(batch.number))?;
            Bytes::from(body)
        }
        other => return Err(CodecError::Malformed(format!("no body has the form {other}"))),
    };
    if body.len() != length || batch.before.then(batch.events, &body) != batch.chain {
        return Err(CodecError::Damaged(batch.number));
    }
    Ok(body)
}

/// The events of a batch's body.
///
/// # Errors
/// When these are not exactly so many events.
pub fn events(body: &[u8], count: u32) -> Result<Vec<Event>, CodecError> {
    let count = count as usize;
    // Each takes a byte at least.
    if count > body.len() {
        return Err(CodecError::Malformed(format!("{} bytes cannot hold {count} events", body.len())));
    }
    let mut events = Vec::with_capacity(count.min(EXPECTED_EVENTS));
    // Reads trees where they are, without a copy of their bytes.
    let mut reader = rmp_serde::Deserializer::from_read_ref(body);
    reader.set_max_depth(MAX_NESTING);
    for _ in 0..count {
        events.push(Event::deserialize(&mut reader).map_err(|error| malformed(&error))?);
    }
    match IgnoredAny::deserialize(&mut reader) {
        // There is no first byte of another value.
        Err(rmp_serde::decode::Error::InvalidMarkerRead(_)) => Ok(events),
        _ => Err(CodecError::Malformed(format!("more than its {count} events are in the batch"))),
    }
}

/// What stands before the body.
struct Head {
    form: u8,
    batch: BatchHead,
    /// Of the body when it is not compressed.
    length: usize,
}

fn read_head(frame: &[u8]) -> Option<Head> {
    let rest = frame.strip_prefix(&[BATCH])?;
    let (&[form], rest) = rest.split_first_chunk()?;
    if form == PART || form == PACKED {
        return None;
    }
    let (&host, rest) = rest.split_first_chunk()?;
    let (&stream, rest) = rest.split_first_chunk()?;
    let (&process, rest) = rest.split_first_chunk()?;
    let (&number, rest) = rest.split_first_chunk()?;
    let (&before, rest) = rest.split_first_chunk()?;
    let (&chain, rest) = rest.split_first_chunk()?;
    let (&events_before, rest) = rest.split_first_chunk()?;
    let (&events, rest) = rest.split_first_chunk()?;
    let (&length, _) = rest.split_first_chunk()?;
    let batch = BatchHead {
        host: HostId::from_bytes(host),
        stream: StreamId::from_bytes(stream),
        process: u64::from_be_bytes(process),
        number: u64::from_be_bytes(number),
        before: Chain::from_bytes(before),
        chain: Chain::from_bytes(chain),
        events: u32::from_be_bytes(events),
        events_before: u64::from_be_bytes(events_before),
    };
    Some(Head { form, batch, length: u32::from_be_bytes(length) as usize })
}

fn malformed(error: &rmp_serde::decode::Error) -> CodecError {
    CodecError::Malformed(error.to_string())
}

#[cfg(test)]
mod fixtures;
#[cfg(test)]
mod tests;
