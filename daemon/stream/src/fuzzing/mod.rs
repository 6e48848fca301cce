//! Any bytes as what an agent and an aggregator send each other: what the fuzz targets in `fuzz/` and the tests run.

mod conversation;
mod script;

pub use self::conversation::any_conversation;

use bytes::Bytes;

use crate::codec::{self, CodecError, MAX_MESSAGE_BYTES, Message};
use crate::{BatchHead, Chain, StreamId, ToAgent, ToAggregator};
use peernet_logger::HostId;

/// Bits of the first byte of [`any_batch`]: what is done to the rest so that chance gets past the hash.
const AS_BODY: u8 = 1;
const COMPRESSED: u8 = 2;

/// The first byte chooses whether the others are a batch's frame, or the body of one that is intact.
///
/// # Panics
/// When a promise is broken: a body that its chain was not computed from or that is too long, a frame that says
/// something else than it was made of.
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
        chain: before.then(events, bytes),
        events,
        events_before: u64::MAX,
    };
    let frame = codec::batch_frame(&head, bytes, how & COMPRESSED != 0);
    assert_eq!(take(&frame), (bytes.len() <= MAX_MESSAGE_BYTES).then_some(head), "what was framed is taken");
}

/// What the aggregator does with a frame; returns the head of an intact batch.
fn take(frame: &[u8]) -> Option<BatchHead> {
    let head = codec::batch_head(frame)?;
    assert!(codec::decode::<ToAggregator>(frame).is_err(), "a batch's frame is no message");
    let body = codec::batch_body(Bytes::copy_from_slice(frame)).ok()?;
    assert!(body.len() <= MAX_MESSAGE_BYTES);
    assert_eq!(head.before.then(head.events, &body), head.chain, "an intact body is the one of the chain");
    if let Ok(events) = codec::events(&body, head.events) {
        assert_eq!(events.len(), head.events as usize);
    }
    Some(head)
}

/// Any bytes as a message of either end.
///
/// # Panics
/// When a message that was read is written in another form than it is read from.
pub fn any_message(data: &[u8]) {
    again(codec::decode::<ToAggregator>(data));
    again(codec::decode::<ToAgent>(data));
}

fn again<M: Message>(message: Result<M, CodecError>) {
    let Ok(message) = message else { return };
    let frame = codec::encode(&message);
    // By bytes: numbers that are none are not equal to themselves.
    let read = codec::decode::<M>(&frame).map(|message| codec::encode(&message));
    assert!(read.is_ok_and(|again| again == frame), "a message is read as it was written");
}
