//! The sending half of a virtual connection: messages that wait, and messages that were sent and are not settled
//! (delivered or counted as lost).

mod long_losses;
mod outstanding;
mod send_queue;

use peernet_clock::MonoTime;

use self::long_losses::LongLossDetector;
pub(super) use self::outstanding::decode_tag;
use self::outstanding::{OutstandingMessages, encode_tag};
pub(crate) use self::send_queue::QueueLimits;
use self::send_queue::SendQueue;
use super::false_claim::FalseClaim;
use super::fragment::{OutgoingMessage, fragment_count};
use super::packet::{Fragment, Terms};
use super::packet_writer::PacketWriter;
use super::window::SendWindow;
use crate::transport::{Frames, MessageLoss, SendFailure};

/// Largest message that is retransmitted when it is lost, bytes. Requests and whole answers, which have a tag, are never
/// retransmitted, whatever their size; the other messages have no tag.
const MAX_RETRANSMITTED_BYTES: u32 = 64 * 1024;

/// Maximum number of bytes of datagrams that are sent together.
// The system takes datagrams that are sent together (UDP_SEGMENT) as one, which has at most 65,507 bytes over IPv4.
const MAX_BATCH_BYTES: usize = 60_000;

/// Datagrams that are sent together. All but the last have the same length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Batch {
    /// Length of each datagram but the last. Bytes.
    pub(crate) segment: usize,
    /// Number of datagrams.
    pub(crate) count: usize,
}

/// The sending half of a connection.
#[derive(Debug)]
pub(crate) struct SendingHalf {
    writer: PacketWriter,
    /// Length of every fragment of a message but the last. Bytes.
    stride: u16,
    window: SendWindow,
    queue: SendQueue,
    outstanding: OutstandingMessages,
    long_losses: LongLossDetector,
    /// Time at which a part of a message was last sent.
    sent_at: MonoTime,
    /// Number of datagrams that were sent, which is also the number of the next datagram.
    datagrams: u64,
    /// Number of datagrams of messages that were retransmitted.
    retransmitted: u64,
}

impl SendingHalf {
    pub(crate) fn new(
        writer: PacketWriter,
        terms: Terms,
        limits: QueueLimits,
        bits_per_second: Option<u64>,
        now: MonoTime,
    ) -> Self {
        Self {
            writer,
            // The stride is at least one byte, whatever the other end claims to accept.
            stride: usize::from(terms.max_datagram_bytes).saturating_sub(writer.data_overhead()).max(1)
                as u16,
            window: SendWindow::new(terms, bits_per_second, now),
            queue: SendQueue::new(limits),
            outstanding: OutstandingMessages::default(),
            long_losses: LongLossDetector::default(),
            sent_at: now,
            datagrams: 0,
            retransmitted: 0,
        }
    }

    /// Queues a message.
    ///
    /// # Errors
    /// If too many messages wait already, or the message is too long.
    pub(crate) fn send(
        &mut self,
        frames: Frames,
        tag: Option<u64>,
        deadline: Option<MonoTime>,
    ) -> Result<(), SendFailure> {
        let bytes: u64 = frames.iter().map(|frame| frame.len() as u64).sum();
        if !self.queue.accepts(bytes) {
            return Err(SendFailure::Full);
        }
        self.enqueue(frames, encode_tag(tag), deadline)
    }

    fn enqueue(&mut self, frames: Frames, tag: u64, deadline: Option<MonoTime>) -> Result<(), SendFailure> {
        // Only messages without a tag are retransmitted. Requests and whole answers have a tag.
        let retransmission = (tag == 0).then(|| frames.clone());
        let message = OutgoingMessage::new(frames, self.outstanding.next_sequence(), tag, deadline)
            .map_err(|error| SendFailure::Gone(error.to_string()))?;
        let retransmission = retransmission.filter(|_| message.total_bytes <= MAX_RETRANSMITTED_BYTES);
        self.outstanding.push(tag, fragment_count(message.total_bytes, self.stride), retransmission);
        self.queue.push(message);
        Ok(())
    }

    /// Returns the number of the message whose part is sent next, and the offset of that part.
    fn send_position(&self) -> (u64, u32) {
        let queued_position = self.queue.front().map(|message| (message.sequence, message.offset));
        queued_position.unwrap_or_else(|| (self.outstanding.next_sequence(), 0))
    }

    /// Returns the number of the first message that has not been sent completely.
    pub(crate) fn next_sequence(&self) -> u64 {
        self.send_position().0
    }

    /// Returns the number of datagrams that were sent, which is also the number of the next datagram.
    pub(crate) const fn datagrams(&self) -> u64 {
        self.datagrams
    }

    /// Returns the number of datagrams of messages that were retransmitted.
    pub(crate) const fn retransmitted(&self) -> u64 {
        self.retransmitted
    }

    /// Returns whether no message waits to be sent.
    pub(crate) fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// Returns the time at which a part of a message was last sent; `None` if all messages that were sent are settled.
    pub(crate) fn last_send_if_unsettled(&self) -> Option<MonoTime> {
        (self.outstanding.first_sequence() < self.next_sequence()).then_some(self.sent_at)
    }

    /// Returns the time at which more can be sent if nothing arrives until then; `None` if no message waits.
    pub(crate) fn opens_at(&self) -> Option<MonoTime> {
        (!self.queue.is_empty()).then(|| self.window.opens_at())
    }

    /// Appends at most `max_datagrams` datagrams that may be sent now. `None` if there are none.
    pub(crate) fn fill(&mut self, out: &mut Vec<u8>, max_datagrams: usize, now: MonoTime) -> Option<Batch> {
        let start = out.len();
        let full_length = self.longest_datagram();
        let mut batch: Option<Batch> = None;
        while self.window.is_open(now)
            && let Some(message) = self.queue.front()
        {
            let count = batch.map_or(0, |batch| batch.count);
            if count >= max_datagrams || (count > 0 && out.len() - start + full_length > MAX_BATCH_BYTES) {
                break;
            }
            // The lifetime is at least 1 ms, because 0 means no deadline.
            let lifetime_ms = message.deadline.map_or(0, |deadline| {
                ((deadline - now).nanos() / 1_000_000).clamp(1, u16::MAX.into()) as u16
            });
            let fragment = Fragment {
                sequence: message.sequence,
                tag: message.tag,
                offset: message.offset,
                total_bytes: message.total_bytes,
                checksum: message.checksum,
                stride: self.stride,
                lifetime_ms,
                bytes: &[],
            };
            let datagram_start = out.len();
            self.writer.write_data_header(self.datagrams as u32, &fragment, out);
            let Some((sequence, end)) = self.queue.take(self.stride, out) else { break };
            self.datagrams += 1;
            let length = out.len() - datagram_start;
            self.window.record_sent(sequence, end, length as u32, now);
            self.sent_at = now;
            let segment = batch.map_or(length, |batch| batch.segment);
            batch = Some(Batch { segment, count: count + 1 });
            // All datagrams of a batch but the last must have the same length (generic segmentation offload). A short
            // datagram therefore ends the batch.
            if length < segment || segment < full_length {
                break;
            }
        }
        batch
    }

    /// Drops the waiting messages whose deadline has passed. Returns these messages as losses.
    pub(crate) fn expire(&mut self, now: MonoTime) -> Vec<MessageLoss> {
        let expired = self.queue.expire(now);
        expired.into_iter().filter_map(|sequence| self.outstanding.mark_lost(sequence)).collect()
    }

    /// Handles a report of progress: everything up to `end` of the message `sequence` has arrived or is lost.
    ///
    /// # Errors
    /// If that part was not sent.
    pub(crate) fn receive_progress(
        &mut self,
        sequence: u64,
        end: u32,
        now: MonoTime,
    ) -> Result<(), FalseClaim> {
        let (current, offset) = self.send_position();
        if sequence > current || (sequence == current && end > offset) {
            return Err(FalseClaim::UnsentMessage);
        }
        self.window.record_progress(sequence, end, now);
        Ok(())
    }

    /// Notes that the other end has settled all messages below this number.
    ///
    /// # Errors
    /// If one of these messages was not sent.
    pub(crate) fn receive_settled(&mut self, below: u64) -> Result<(), FalseClaim> {
        let (current, offset) = self.send_position();
        // The other end may have given up a message of which only a part was sent.
        if below > current + u64::from(offset > 0) {
            return Err(FalseClaim::UnsentMessage);
        }
        for arrived in self.outstanding.settle(below) {
            self.long_losses.record_arrival(arrived.fragments);
        }
        Ok(())
    }

    /// Handles the report of a lost message. `received` of its fragments arrived. `lost_datagrams` is the number of
    /// lost datagrams that the other end has reported. Returns the tag and the number of fragments of the message, with
    /// which the report is acknowledged ([`Packet::LostAck`](super::packet::Packet::LostAck)), and the loss for the layer
    /// above; `None` if the layer above is not informed.
    ///
    /// # Errors
    /// If the message was not sent, or has fewer fragments than are reported as received.
    pub(crate) fn receive_loss(
        &mut self,
        (sequence, received): (u64, u32),
        lost_datagrams: u64,
        now: MonoTime,
    ) -> Result<(u64, u32, Option<MessageLoss>), FalseClaim> {
        let (current, offset) = self.send_position();
        // Only a message of which something was sent can be lost.
        if sequence > current || (sequence == current && offset == 0) {
            return Err(FalseClaim::UnsentMessage);
        }
        // If the message is settled or too old, the acknowledgement only makes the other end stop its reports.
        let Some(message) = self.outstanding.get_mut(sequence) else { return Ok((0, 0, None)) };
        let (tag, fragments) = (message.tag, message.fragments);
        if received > fragments {
            return Err(FalseClaim::TooManyFragments);
        }
        if sequence == current {
            // The other end has given up the message, for example because it has no memory for the message. Sending the
            // remaining fragments would be useless and would delay the report of the loss to the layer above.
            self.queue.drop_front();
        }
        if std::mem::replace(&mut message.is_lost, true) {
            return Ok((tag, fragments, None));
        }
        let retransmission = message.retransmission.take();
        self.window.record_loss();
        self.long_losses.record_loss(fragments, received, lost_datagrams, now);
        // A retransmitted message gets a new number, because the other end has settled the old number.
        if let Some(frames) = retransmission
            && self.enqueue(frames, encode_tag(None), None).is_ok()
        {
            self.retransmitted += u64::from(fragments);
            return Ok((tag, fragments, None));
        }
        Ok((tag, fragments, Some(MessageLoss { tag: decode_tag(tag), received, total: fragments })))
    }

    /// Returns whether the longest datagrams no longer arrive. `lost_datagrams` is the number of lost datagrams that
    /// the other end has reported. This number is needed because the other end may also give up messages for other
    /// reasons.
    pub(crate) fn loses_all_long_datagrams(&self, lost_datagrams: u64, now: MonoTime) -> bool {
        self.long_losses.loses_all(lost_datagrams, now)
    }

    /// Returns the length of the longest datagrams that are sent.
    pub(crate) fn longest_datagram(&self) -> usize {
        self.writer.data_overhead() + usize::from(self.stride)
    }

    pub(crate) fn tick(&mut self, now: MonoTime) {
        self.window.tick(now);
    }
}
