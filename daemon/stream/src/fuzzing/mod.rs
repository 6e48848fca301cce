//! Conversations made of arbitrary bytes, for the fuzz targets in `fuzz/` and for tests.

mod conversation;
mod script;

pub use self::conversation::any_conversation;

use bytes::Bytes;

use crate::codec::{self, CodecError, MAX_MESSAGE_BYTES, Message};
use crate::{BatchHead, ChainHash, StreamId, ToAgent, ToAggregator};
use peernet_logger::HostId;

/// Bit of the first byte of [`any_batch`]: the other bytes are the body of a batch, for which `any_batch` computes the
/// hash. Hardly any random frame has the right hash.
const BODY_FLAG: u8 = 1;
/// Bit of the first byte of [`any_batch`]: the body is compressed.
const COMPRESSED_FLAG: u8 = 2;

/// Reads arbitrary bytes as a batch. The first byte selects whether the other bytes are the frame of a batch or the
/// body of an intact batch.
///
/// # Panics
/// If a guarantee is violated: a body is accepted that does not match its chain hash or is too long, or a written frame
/// is read as another batch.
pub fn any_batch(data: &[u8]) {
    let Some((&flags, bytes)) = data.split_first() else { return };
    if flags & BODY_FLAG == 0 {
        handle_frame(bytes);
        return;
    }
    let (chain_before, events) = (ChainHash::from_bytes([flags; 16]), u32::from(flags >> 2));
    let head = BatchHead {
        host: HostId::from_bytes([1; 16]),
        stream: StreamId::from_bytes([2; 16]),
        process: 3,
        number: u64::MAX,
        previous_chain: chain_before,
        chain: chain_before.next(events, bytes),
        events,
        events_before: u64::MAX,
    };
    let frame = codec::encode_batch(&head, bytes, flags & COMPRESSED_FLAG != 0);
    assert_eq!(
        handle_frame(&frame),
        (bytes.len() <= MAX_MESSAGE_BYTES).then_some(head),
        "a body within the limit is accepted"
    );
}

/// Handles a frame as the aggregator does. Returns the head of an intact batch.
fn handle_frame(frame: &[u8]) -> Option<BatchHead> {
    let head = codec::decode_batch_head(frame)?;
    assert!(codec::decode::<ToAggregator>(frame).is_err(), "a batch's frame is not a message");
    let body = codec::decode_batch_body(Bytes::copy_from_slice(frame)).ok()?;
    assert!(body.len() <= MAX_MESSAGE_BYTES);
    assert_eq!(
        head.previous_chain.next(head.events, &body),
        head.chain,
        "an intact body matches its chain hash"
    );
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
    assert_round_trip(codec::decode::<ToAggregator>(data));
    assert_round_trip(codec::decode::<ToAgent>(data));
}

fn assert_round_trip<M: Message>(message: Result<M, CodecError>) {
    let Ok(message) = message else { return };
    let frame = codec::encode(&message);
    // The messages are compared by bytes, because NaN does not equal itself.
    let reencoded = codec::decode::<M>(&frame).map(|message| codec::encode(&message));
    assert!(reencoded.is_ok_and(|reencoded| reencoded == frame), "a message is read as it was written");
}
