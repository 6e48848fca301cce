//! The wire form of an answer, and the number of answers that are being sent.

use std::sync::atomic::{AtomicUsize, Ordering};

use bytes::Bytes;
use peernet_clock::{Clock, MonoTime, Span};
use peernet_logger::Recorder;
use peernet_sample::Sample;
use tokio::sync::Notify;

use crate::message::{
    Departure, Header, HeaderError, Outcome, PartialReply, RAW_STAMPS_SINCE, Reply, SampleHeader,
    encode_tree_delta,
};
use crate::session::incoming::{Failure, RequestKey};
use crate::session::server::Route;
use crate::transport::Frames;

/// Counts the answers that are being sent. The request of such an answer may no longer be in flight.
#[derive(Debug, Default)]
pub(super) struct AnswersBeingSent {
    count: AtomicUsize,
    answer_sent: Notify,
}

impl AnswersBeingSent {
    /// Calls `send`, and counts an answer as being sent until it returns.
    pub(super) fn count_while(&self, send: impl FnOnce()) {
        self.count.fetch_add(1, Ordering::SeqCst);
        send();
        self.count.fetch_sub(1, Ordering::SeqCst);
        // If nobody waits yet, the permit is kept for the next waiter, so no wake-up is lost.
        self.answer_sent.notify_one();
    }

    /// Waits until no answer is being sent and no request is in flight.
    pub(super) async fn wait_until_idle(&self, in_flight: impl Fn() -> usize) {
        // The requests are read first: a request that ends between the two reads is already counted as an answer.
        while in_flight() > 0 || self.count.load(Ordering::SeqCst) > 0 {
            self.answer_sent.notified().await;
        }
    }
}

/// Content of an answer, without the stamps of its departure.
#[derive(Clone, Debug)]
pub(super) struct AnswerContent {
    outcome: Outcome,
    payload: Vec<Bytes>,
    /// Nodes that this host added to the tree.
    delta: Option<Bytes>,
    /// Offset of the monotonic clock's zero from this host's anchor in the tree. The recorder could compute the
    /// departure's offset, but the recorder is consumed before the departure is stamped.
    clock_zero_offset: Span,
}

impl AnswerContent {
    /// Returns the content of an answer with the nodes that `recorder` recorded here.
    pub(super) fn new(route: &Route, recorder: Option<Recorder>, result: Result<Sample, Failure>) -> Self {
        let (outcome, payload) = encode_outcome(result, route.max_message_bytes);
        let (delta, clock_zero_offset) = encode_recorded_delta(recorder);
        Self { outcome, payload, delta, clock_zero_offset }
    }
}

/// Encodes an answer. The departure is stamped last.
///
/// # Errors
/// If the header cannot be encoded.
pub(super) fn encode_answer(
    clock: &dyn Clock,
    route: &Route,
    key: RequestKey,
    content: AnswerContent,
) -> Result<Frames, HeaderError> {
    let AnswerContent { outcome, payload, delta, clock_zero_offset } = content;
    let has_raw_stamps = route.version >= RAW_STAMPS_SINCE;
    let stamp = clock.stamp();
    // The epoch is read after the stamp: if it equals the epoch of the arrival, no step lies between the two stamps.
    let epoch = if has_raw_stamps { clock.epoch() } else { clock.wall_epoch() };
    let departure = delta.as_ref().map(|_| {
        let sent_since_anchor = clock_zero_offset + (stamp.mono - MonoTime::default());
        let sent_raw = has_raw_stamps.then_some(stamp.raw);
        Departure { sent: stamp.wall, sent_since_anchor, epoch, sent_raw }
    });
    let RequestKey { session, request, arrival } = key;
    let arrival_epoch = if has_raw_stamps { arrival.epoch } else { arrival.wall_epoch };
    let arrived_raw = departure.filter(|_| has_raw_stamps).map(|_| arrival.raw);
    let reply = Reply { session, request, departure, arrival_epoch, outcome, arrived_raw };
    let header = Header::Reply(reply).encode()?;
    let mut frames = Vec::with_capacity(2 + payload.len());
    frames.extend([header, delta.unwrap_or_default()]);
    frames.extend(payload);
    Ok(frames)
}

/// Encodes a partial answer with its number; the request was received at `received`. The departure is stamped last.
///
/// # Errors
/// If the header cannot be encoded.
pub(super) fn encode_partial_answer(
    clock: &dyn Clock,
    key: RequestKey,
    (number, received): (u32, MonoTime),
    partial_answer: &Sample,
) -> Result<Frames, HeaderError> {
    let sample = SampleHeader::from_sample(partial_answer)?;
    let stamp = clock.stamp();
    let departure = Departure {
        sent: stamp.wall,
        // The cloud's anchor is the arrival of the request.
        sent_since_anchor: stamp.mono - received,
        // Every version with partial replies has stamps of the free-running clock.
        epoch: clock.epoch(),
        sent_raw: Some(stamp.raw),
    };
    let RequestKey { session, request, .. } = key;
    let header = Header::PartialReply(PartialReply { session, request, part: number, departure, sample });
    let mut frames = Vec::with_capacity(2 + partial_answer.parts.len());
    // Frame 1 is empty, so that the payload begins at frame 2 as in every message.
    frames.extend([header.encode()?, Bytes::new()]);
    frames.extend(partial_answer.parts.iter().map(|part| part.bytes.clone()));
    Ok(frames)
}

/// Returns the outcome and the payload that are sent for a result. An answer that is larger than the edge accepts
/// becomes a failure.
fn encode_outcome(result: Result<Sample, Failure>, max_message_bytes: u64) -> (Outcome, Vec<Bytes>) {
    let failed = |reason: String| (Outcome::Failed(reason), Vec::new());
    match result {
        Ok(sample) if sample.payload_bytes() > max_message_bytes => failed(format!(
            "the answer has {} bytes, more than the edge's max_message_bytes, {max_message_bytes}: raise max_message_bytes on \
             the edge (peernet --client: --max-message-bytes)",
            sample.payload_bytes()
        )),
        Ok(sample) => match SampleHeader::from_sample(&sample) {
            Ok(header) => {
                (Outcome::Answer(header), sample.parts.into_iter().map(|part| part.bytes).collect())
            }
            Err(error) => failed(format!("the answer cannot be sent: {error}")),
        },
        Err(Failure::Failed(reason)) => failed(reason),
        Err(Failure::Overloaded(reason)) => (Outcome::Overloaded(reason), Vec::new()),
    }
}

/// Returns the wire form of the tree delta, and the offset of the monotonic clock's zero from this host's anchor.
fn encode_recorded_delta(recorder: Option<Recorder>) -> (Option<Bytes>, Span) {
    let Some(recorder) = recorder else { return (None, Span::ZERO) };
    let clock_zero_offset = recorder.offset(MonoTime::default());
    let delta = recorder.into_tree_delta().and_then(|delta| match encode_tree_delta(&delta) {
        Ok(wire) => Some(wire),
        Err(error) => {
            tracing::warn!(%error, "cannot encode the tree delta of an answer; the answer is sent without the nodes of this host");
            None
        }
    });
    (delta, clock_zero_offset)
}
