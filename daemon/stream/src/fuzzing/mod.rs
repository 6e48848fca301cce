//! Conversations made of arbitrary bytes, for the fuzz targets in `fuzz/` and for tests.

mod conversation;
mod script;

pub use self::conversation::any_conversation;

use bytes::Bytes;

use crate::codec::{self, CodecError, MAX_MESSAGE_BYTES, Message};
use crate::{BatchHead, Chain, StreamId, ToAgent, ToAggregator};
use peernet_logger::HostId;

/// Bits of the first byte of [`any_batch`], which tell how to treat the others so that random bytes pass the check of
/// the hash.
const AS_BODY: u8 = 1;
const COMPRESSED: u8 = 2;

/// Reads arbitrary bytes as a batch. The first byte selects whether the others are a batch's frame or the body of an
/// intact one.
///
/// # Panics
/// If a guarantee is violated: a body is accepted that does not match its chain or is too long, or a frame is read
/// differently than it was written.
pub fn any_batch(data: &[u8]) {
    let Some((&how, bytes)) = data.split_first() else { return };
    if how & AS_BODY == 0 {
        take(bytes);
        return;
    }
    let (before, events) = (Chain::from_bytes([how; 16]), u32::from(how >> 2));
    let head = BatchHead {
        host: HostId::from_bytes([1; 16]),
        stream: StreamId::from_bytes([2; 16]),
        process: 3,
        number: u64::MAX,
        before,
        chain: before.next(events, bytes),
        events,
        events_before: u64::MAX,
    };
    let frame = codec::encode_batch(&head, bytes, how & COMPRESSED != 0);
    assert_eq!(take(&frame), (bytes.len() <= MAX_MESSAGE_BYTES).then_some(head), "what was framed is taken");
}

/// Handles a frame as the aggregator does. Returns the head of an intact batch.
fn take(frame: &[u8]) -> Option<BatchHead> {
    let head = codec::decode_batch_head(frame)?;
    assert!(codec::decode::<ToAggregator>(frame).is_err(), "a batch's frame is no message");
    let body = codec::decode_batch_body(Bytes::copy_from_slice(frame)).ok()?;
    assert!(body.len() <= MAX_MESSAGE_BYTES);
    assert_eq!(head.before.next(head.events, &body), head.chain, "an intact body is the one of the chain");
    if let Ok(events) = codec::decode_events(&body, head.events) {
        assert_eq!(events.len(), head.events as usize);
    }
    Some(head)
}

/// Reads arbitrary bytes as a message of either end.
///
/// # Panics
/// If a decoded message, encoded and decoded again, is another message.
pub fn any_message(data: &[u8]) {
    again(codec::decode::<ToAggregator>(data));
    again(codec::decode::<ToAgent>(data));
}

fn again<M: Message>(message: Result<M, CodecError>) {
    let Ok(message) = message else { return };
    let frame = codec::encode(&message);
    // Compared by bytes, because NaN does not equal itself.
    let read = codec::decode::<M>(&frame).map(|message| codec::encode(&message));
    assert!(read.is_ok_and(|again| again == frame), "a message is read as it was written");
}
