//! The sending half of a virtual connection: messages that wait, and what became of those that left.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

use super::counting::ArrivalTotals;
use super::false_claim::FalseClaim;
use super::fragment::{OutgoingMessage, fragment_count};
use super::packet::{DATA_HEADER_BYTES, Fragment, Role, Terms, write_data_header};
use super::reassembly::MAX_SPAN;
use super::window::SendWindow;
use crate::statistics::DatagramStatistics;
use crate::transport::{Frames, MessageLoss, SendFailure};

/// Largest message without a tag that is sent again when it is lost: what opens and closes sessions.
const MAX_KEPT_BYTES: u32 = 64 * 1024;

/// Long datagrams do not pass when so many messages in a row, and for at least so long, lost all of them. Chance alone
/// does so once in 40,000 times where 30 % are lost and messages have two datagrams.
const LONG_LOST: u32 = 16;
const LONG_LOST_FOR: Span = Span::from_seconds(1);

/// Most bytes of datagrams that leave at once.
const MAX_BATCH_BYTES: usize = 60_000;

/// What may wait to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct QueueLimits {
    /// Messages.
    pub(crate) messages: usize,
    /// Bytes; a single message is always taken.
    pub(crate) bytes: u64,
}

/// Datagrams that leave together: all but the last have the same length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Batch {
    /// Bytes of each datagram but the last.
    pub(crate) segment: usize,
    /// How many there are.
    pub(crate) count: usize,
}

/// A message that left or waits.
#[derive(Debug)]
struct Record {
    /// As it is written: 0 for none.
    tag: u64,
    fragments: u32,
    /// The message, while it may have to be sent again.
    kept: Option<Frames>,
    is_lost: bool,
}

/// Messages of several datagrams in a row of which at most one arrived.
#[derive(Clone, Copy, Debug)]
struct LongLosses {
    messages: u32,
    /// Datagrams that were lost before, as far as the other end had told.
    before: u64,
    /// When the first of them was told of.
    since: MonoTime,
}

/// The sending half.
#[derive(Debug)]
pub(crate) struct Sending {
    role: Role,
    connection: u64,
    prefix: &'static [u8],
    stride: u16,
    limits: QueueLimits,
    window: SendWindow,
    queue: VecDeque<OutgoingMessage>,
    queued_bytes: u64,
    next: u64,
    /// Of the messages from `first` on, until the other end has settled them.
    records: VecDeque<Record>,
    first: u64,
    /// When a part of a message last left.
    sent_at: MonoTime,
    /// Datagrams that left: the number of the next.
    datagrams: u64,
    /// Datagrams of messages that were sent again.
    retransmitted: u64,
    long_losses: Option<LongLosses>,
}

/// The number for a tag on the wire, where 0 is none.
fn written_tag(tag: Option<u64>) -> u64 {
    tag.map_or(0, |tag| tag.wrapping_add(1))
}

/// The tag that a number on the wire stands for.
pub(crate) fn read_tag(written: u64) -> Option<u64> {
    written.checked_sub(1)
}

impl Sending {
    pub(crate) fn new(
        (role, connection, prefix): (Role, u64, &'static [u8]),
        terms: Terms,
        limits: QueueLimits,
        bits_per_second: Option<u64>,
        now: MonoTime,
    ) -> Self {
        let overhead = prefix.len() + DATA_HEADER_BYTES;
        Self {
            role,
            connection,
            prefix,
            stride: usize::from(terms.datagram).saturating_sub(overhead).max(1) as u16,
            limits,
            window: SendWindow::new(terms, bits_per_second, now),
            queue: VecDeque::new(),
            queued_bytes: 0,
            next: 0,
            records: VecDeque::new(),
            first: 0,
            sent_at: now,
            datagrams: 0,
            retransmitted: 0,
            long_losses: None,
        }
    }

    /// Queues a message.
    ///
    /// # Errors
    /// When too much waits already.
    pub(crate) fn send(
        &mut self,
        frames: Frames,
        tag: Option<u64>,
        deadline: Option<MonoTime>,
    ) -> Result<(), SendFailure> {
        let bytes: u64 = frames.iter().map(|frame| frame.len() as u64).sum();
        let is_full =
            self.queue.len() >= self.limits.messages || self.queued_bytes + bytes > self.limits.bytes;
        if !self.queue.is_empty() && is_full {
            return Err(SendFailure::Full);
        }
        self.enqueue(frames, written_tag(tag), deadline)
    }

    fn enqueue(&mut self, frames: Frames, tag: u64, deadline: Option<MonoTime>) -> Result<(), SendFailure> {
        let kept = (tag == 0).then(|| frames.clone());
        let message = OutgoingMessage::new(frames, self.next, tag, deadline)
            .map_err(|error| SendFailure::Gone(error.to_string()))?;
        let kept = kept.filter(|_| message.total <= MAX_KEPT_BYTES);
        let fragments = fragment_count(message.total, self.stride);
        if self.records.len() as u64 >= MAX_SPAN {
            self.records.pop_front();
            self.first += 1;
        }
        self.records.push_back(Record { tag, fragments, kept, is_lost: false });
        self.next += 1;
        self.queued_bytes += u64::from(message.total);
        self.queue.push_back(message);
        Ok(())
    }

    /// The number of the first message that has not left as a whole.
    pub(crate) fn next(&self) -> u64 {
        self.queue.front().map_or(self.next, |message| message.sequence)
    }

    /// Datagrams that left: the number of the next.
    pub(crate) const fn datagrams(&self) -> u64 {
        self.datagrams
    }

    /// Totals of this direction; `arrivals` is what the other end told, if it has.
    pub(crate) fn statistics(&self, arrivals: Option<ArrivalTotals>) -> DatagramStatistics {
        DatagramStatistics {
            datagrams: Some(self.datagrams),
            lost: arrivals.map(|told| told.lost),
            duplicated: arrivals.map(|told| told.duplicated),
            reordered: arrivals.map(|told| told.reordered),
            retransmitted: Some(self.retransmitted),
        }
    }

    /// Whether nothing waits to be sent.
    pub(crate) fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// When the other end should be asked what has arrived: `pause` after the last message, and every `period` while
    /// they follow each other. `None` when nothing is open.
    pub(crate) fn asks_at(&self, pinged: MonoTime, (pause, period): (Span, Span)) -> Option<MonoTime> {
        (self.first < self.next()).then(|| (self.sent_at.max(pinged) + pause).min(pinged + period))
    }

    /// When something more can leave, if nothing is heard until then.
    pub(crate) fn opens_at(&self) -> Option<MonoTime> {
        (!self.queue.is_empty()).then(|| self.window.opens_at())
    }

    /// Appends datagrams that leave now, at most so many. Returns `None` when there are none.
    pub(crate) fn fill(&mut self, out: &mut Vec<u8>, most: usize, now: MonoTime) -> Option<Batch> {
        let start = out.len();
        let full = self.longest();
        let mut batch: Option<Batch> = None;
        while self.window.is_open(now)
            && let Some(message) = self.queue.front_mut()
        {
            let count = batch.map_or(0, |batch| batch.count);
            if count >= most || (count > 0 && out.len() - start + full > MAX_BATCH_BYTES) {
                break;
            }
            let lifetime_ms = message.deadline.map_or(0, |deadline| {
                ((deadline - now).nanos() / 1_000_000).clamp(1, u16::MAX.into()) as u16
            });
            let fragment = Fragment {
                sequence: message.sequence,
                tag: message.tag,
                offset: message.offset,
                total: message.total,
                checksum: message.checksum,
                stride: self.stride,
                lifetime_ms,
                bytes: &[],
            };
            let begin = out.len();
            out.extend_from_slice(self.prefix);
            write_data_header(self.role, (self.connection, self.datagrams as u32), &fragment, out);
            self.datagrams += 1;
            let (_, taken) = message.take(self.stride, out);
            let length = out.len() - begin;
            self.window.sent(message.sequence, message.offset, length as u32, now);
            self.sent_at = now;
            self.queued_bytes -= u64::from(taken);
            if message.is_done() {
                self.queue.pop_front();
            }
            let segment = batch.map_or(length, |batch| batch.segment);
            batch = Some(Batch { segment, count: count + 1 });
            // A shorter one can only be the last, and after a short first one there is no longer one.
            if length < segment || segment < full {
                break;
            }
        }
        batch
    }

    /// Drops the waiting messages whose deadline is over. Returns their tags and fragments.
    pub(crate) fn expire(&mut self, now: MonoTime) -> Vec<MessageLoss> {
        let mut expired = Vec::new();
        let (first, records, queued) = (self.first, &mut self.records, &mut self.queued_bytes);
        self.queue.retain(|message| {
            if message.deadline.is_none_or(|deadline| now < deadline) {
                return true;
            }
            *queued -= u64::from(message.remaining());
            let at = message.sequence.checked_sub(first).and_then(|at| usize::try_from(at).ok());
            if let Some(record) = at.and_then(|at| records.get_mut(at)) {
                record.is_lost = true;
                expired.push(MessageLoss { tag: read_tag(record.tag), received: 0, total: record.fragments });
            }
            false
        });
        expired
    }

    /// How far sending has come: the message of which the next part leaves, and where that part begins.
    fn position(&self) -> (u64, u32) {
        self.queue.front().map_or((self.next, 0), |message| (message.sequence, message.offset))
    }

    /// The other end has come so far.
    ///
    /// # Errors
    /// When so much was not sent.
    pub(crate) fn progress(&mut self, sequence: u64, end: u32, now: MonoTime) -> Result<(), FalseClaim> {
        let (current, offset) = self.position();
        if sequence > current || (sequence == current && end > offset) {
            return Err(FalseClaim::Unsent);
        }
        self.window.progress(sequence, end, now);
        Ok(())
    }

    /// The other end has settled all messages below this number.
    ///
    /// # Errors
    /// When one of them was not sent.
    pub(crate) fn settled(&mut self, below: u64) -> Result<(), FalseClaim> {
        let (current, offset) = self.position();
        // What has begun to leave may have been given up already.
        if below > current + u64::from(offset > 0) {
            return Err(FalseClaim::Unsent);
        }
        while self.first < below
            && let Some(record) = self.records.pop_front()
        {
            self.first += 1;
            if record.fragments > 1 && !record.is_lost {
                self.long_losses = None;
            }
        }
        Ok(())
    }

    /// The other end says that a message is lost; `lost` is as in [`loses_long`](Self::loses_long). Returns what to tell it,
    /// and what to tell here.
    ///
    /// # Errors
    /// When the message was not sent, or has fewer fragments than are said to have arrived.
    pub(crate) fn lost(
        &mut self,
        (sequence, received): (u64, u32),
        lost: u64,
        now: MonoTime,
    ) -> Result<(u64, u32, Option<MessageLoss>), FalseClaim> {
        let (current, offset) = self.position();
        if sequence > current || (sequence == current && offset == 0) {
            return Err(FalseClaim::Unsent);
        }
        let at = sequence.checked_sub(self.first).and_then(|at| usize::try_from(at).ok());
        // A message that is being sent cannot be lost yet.
        let Some(record) = at.filter(|_| sequence < current).and_then(|at| self.records.get_mut(at)) else {
            return Ok((0, 0, None));
        };
        let (tag, fragments) = (record.tag, record.fragments);
        if received > fragments {
            return Err(FalseClaim::Fragments);
        }
        if std::mem::replace(&mut record.is_lost, true) {
            return Ok((tag, fragments, None));
        }
        let kept = record.kept.take();
        self.window.lost();
        // The one that arrived may be the last, which is shorter than the others.
        if received > 1 {
            self.long_losses = None;
        } else if fragments > 1 {
            self.long_losses.get_or_insert(LongLosses { messages: 0, before: lost, since: now }).messages +=
                1;
        }
        if let Some(frames) = kept
            && self.enqueue(frames, 0, None).is_ok()
        {
            self.retransmitted += u64::from(fragments);
            return Ok((tag, fragments, None));
        }
        Ok((tag, fragments, Some(MessageLoss { tag: read_tag(tag), received, total: fragments })))
    }

    /// Whether none of the longest datagrams arrives any more. `lost` is the number of lost datagrams that the other end
    /// has told: it may give messages up for other reasons, too.
    pub(crate) fn loses_long(&self, lost: u64, now: MonoTime) -> bool {
        self.long_losses.is_some_and(|losses| {
            losses.messages >= LONG_LOST
                && lost.saturating_sub(losses.before) >= u64::from(LONG_LOST)
                && now - losses.since >= LONG_LOST_FOR
        })
    }

    /// Bytes of the longest datagrams that are sent.
    pub(crate) fn longest(&self) -> usize {
        self.prefix.len() + DATA_HEADER_BYTES + usize::from(self.stride)
    }

    pub(crate) fn tick(&mut self, now: MonoTime) {
        self.window.tick(now);
    }
}
