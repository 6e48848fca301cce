//! Reassembles messages from the fragments of one connection, in bounded memory.
//!
//! Fragments may be missing, duplicated, late or forged. Every message number is *settled* once: its message is
//! delivered or counted as lost. All numbers below [`Reassembly::floor`] are settled. From there on the states of at
//! most [`MAX_SPAN`] numbers are stored. When a higher number arrives, the messages with the lowest numbers are given
//! up.

use std::collections::VecDeque;
use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};

use super::fragment::fragment_count;
use super::packet::Fragment;
use super::partial_message::{AddOutcome, PartialMessage};
use crate::transport::memory::{BudgetExhausted, MemoryBudget, Reservation};

/// Maximum number of message numbers whose state is stored.
pub(crate) const MAX_SPAN: u64 = 1_024;

/// A message whose number does not fit into [`MAX_SPAN`] states is accepted only if the number is less than this
/// distance above the numbers that are known to have been sent.
const MAX_AHEAD: u64 = 64;

/// Limits of unfinished messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ReassemblyLimits {
    /// Largest message. Bytes.
    pub(crate) max_message_bytes: u32,
    /// Maximum number of messages of which a part has arrived.
    pub(crate) max_unfinished_messages: usize,
    /// Time limit for missing fragments after the whole message is known to have been sent.
    pub(crate) timeout: Span,
    /// Time limit between two fragments of a message that is not known to have been sent as a whole.
    pub(crate) idle_timeout: Span,
}

/// Outcome of a fragment.
#[derive(Debug)]
pub(crate) enum ReassemblyOutcome {
    /// The fragment completes this message.
    Message {
        /// The message.
        bytes: Bytes,
        /// Reservation of its memory.
        reserved: Reservation,
    },
    /// The fragment is stored, or its message was given up because it is too long or would exceed the budget.
    Stored,
    /// The fragment had arrived before, or its message is settled.
    Duplicate,
    /// The fragment contradicts earlier fragments of its message, or completes a message with a wrong checksum.
    Inconsistent,
    /// The message's number is too far above all numbers that are known to have been sent.
    TooFarAhead,
}

/// A message that will not be delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LostMessage {
    pub(crate) sequence: u64,
    /// The sender's number for the message; `None` if no fragment has arrived.
    pub(crate) tag: Option<u64>,
    /// Number of fragments that have arrived.
    pub(crate) received: u32,
    /// Number of fragments of the message; 0 if no fragment has arrived.
    pub(crate) total: u32,
}

/// Messages of one direction of a connection.
#[derive(Debug)]
pub(crate) struct Reassembly {
    limits: ReassemblyLimits,
    budget: Arc<MemoryBudget>,
    /// Number below which all messages are settled.
    floor: u64,
    /// Messages below this number are known to have been sent completely, because their sender sends one message after
    /// the other. Only these messages count as lost if no fragment of them arrives.
    sent_below: u64,
    /// States of the numbers from the floor on. The first number is not settled.
    slots: VecDeque<Slot>,
    /// Number of unfinished messages among the slots.
    unfinished_count: usize,
    /// Messages that were lost since the last call of [`take_lost`](Self::take_lost).
    lost: Vec<LostMessage>,
}

/// State of one message number.
#[derive(Debug)]
enum Slot {
    /// No fragment has arrived. The number has been known since this time.
    Missing { since: MonoTime },
    /// A part of the message has arrived.
    // Boxed, so that slots without a fragment are small: a connection may have many of them.
    Unfinished(Box<UnfinishedMessage>),
    /// The message was delivered or counted as lost.
    Settled,
}

#[derive(Debug)]
struct UnfinishedMessage {
    tag: u64,
    checksum: u32,
    stride: u16,
    message: PartialMessage,
    /// Number of fragments that have arrived.
    received_fragments: u32,
    /// Number of fragments of the message.
    total_fragments: u32,
    deadline: Option<MonoTime>,
    /// Time at which the last new fragment arrived.
    progress_at: MonoTime,
    /// Time since which this end knows that the whole message was sent.
    sent_at: Option<MonoTime>,
}

impl Reassembly {
    pub(crate) fn new(limits: ReassemblyLimits, budget: Arc<MemoryBudget>) -> Self {
        Self {
            limits,
            budget,
            floor: 0,
            sent_below: 0,
            slots: VecDeque::new(),
            unfinished_count: 0,
            lost: Vec::new(),
        }
    }

    /// Replaces the limits and the budget. Messages that have arrived in part are kept.
    pub(crate) fn set_limits(&mut self, limits: ReassemblyLimits, budget: Arc<MemoryBudget>) {
        self.limits = limits;
        self.budget = budget;
    }

    /// Returns the number below which all messages are settled.
    pub(crate) const fn floor(&self) -> u64 {
        self.floor
    }

    /// Returns whether all messages that are known to have been sent are settled.
    pub(crate) const fn is_settled(&self) -> bool {
        self.floor >= self.sent_below && self.unfinished_count == 0
    }

    /// Removes and returns the messages that were lost since the last call.
    pub(crate) fn take_lost(&mut self) -> Vec<LostMessage> {
        std::mem::take(&mut self.lost)
    }

    /// Handles a fragment.
    pub(crate) fn receive(&mut self, fragment: &Fragment<'_>, now: MonoTime) -> ReassemblyOutcome {
        if fragment.sequence < self.floor {
            return ReassemblyOutcome::Duplicate;
        }
        // A single altered number must not make all unfinished messages count as lost.
        let limit = self.floor.saturating_add(MAX_SPAN).max(self.sent_below.saturating_add(MAX_AHEAD));
        if fragment.sequence >= limit {
            return ReassemblyOutcome::TooFarAhead;
        }
        self.extend(fragment.sequence.saturating_add(1), now);
        let index = (fragment.sequence - self.floor) as usize;
        let outcome = match self.slots.get_mut(index) {
            None | Some(Slot::Settled) => Ok(ReassemblyOutcome::Duplicate),
            Some(Slot::Unfinished(unfinished)) => unfinished.add(fragment, &self.budget, now),
            Some(Slot::Missing { .. }) => self.start_message(fragment, now),
        };
        match outcome {
            Ok(ReassemblyOutcome::Stored) => self.deliver_if_complete(fragment.sequence),
            Ok(outcome) => outcome,
            Err(BudgetExhausted) => {
                self.give_up_slot(fragment.sequence);
                ReassemblyOutcome::Stored
            }
        }
    }

    /// Starts a message of which nothing had arrived.
    fn start_message(
        &mut self,
        fragment: &Fragment<'_>,
        now: MonoTime,
    ) -> Result<ReassemblyOutcome, BudgetExhausted> {
        let total_fragments = fragment_count(fragment.total_bytes, fragment.stride);
        let mut unfinished = UnfinishedMessage {
            tag: fragment.tag,
            checksum: fragment.checksum,
            stride: fragment.stride,
            message: PartialMessage::new(fragment.total_bytes, &self.budget),
            received_fragments: 0,
            total_fragments,
            deadline: (fragment.lifetime_ms > 0)
                .then(|| now + Span::from_millis(fragment.lifetime_ms.into())),
            progress_at: now,
            sent_at: (fragment.sequence < self.sent_below).then_some(now),
        };
        // A message that is too long counts as lost, like a message for which there is no memory, so that its sender is
        // informed.
        let outcome = if fragment.total_bytes > self.limits.max_message_bytes {
            unfinished.received_fragments = 1;
            Err(BudgetExhausted)
        } else {
            unfinished.add(fragment, &self.budget, now)
        };
        // A message that is complete or given up at once does not displace an unfinished message.
        let stays_unfinished = outcome.is_ok() && total_fragments > 1;
        if stays_unfinished && self.unfinished_count >= self.limits.max_unfinished_messages {
            self.give_up_oldest();
        }
        // Giving up the oldest message may have moved the floor.
        let index = (fragment.sequence - self.floor) as usize;
        if let Some(slot) = self.slots.get_mut(index) {
            *slot = Slot::Unfinished(Box::new(unfinished));
            self.unfinished_count += 1;
        }
        outcome
    }

    /// Delivers the message of a number if it is complete.
    fn deliver_if_complete(&mut self, sequence: u64) -> ReassemblyOutcome {
        let index = (sequence - self.floor) as usize;
        let Some(slot) = self.slots.get_mut(index) else { return ReassemblyOutcome::Stored };
        if !matches!(slot, Slot::Unfinished(unfinished) if unfinished.received_fragments == unfinished.total_fragments)
        {
            return ReassemblyOutcome::Stored;
        }
        let Slot::Unfinished(unfinished) = std::mem::replace(slot, Slot::Settled) else {
            return ReassemblyOutcome::Stored;
        };
        self.unfinished_count -= 1;
        self.advance_floor();
        let lost = unfinished.to_loss(sequence);
        let (bytes, reserved) = unfinished.message.into_bytes();
        if crc32fast::hash(&bytes) != unfinished.checksum {
            self.lost.push(lost);
            return ReassemblyOutcome::Inconsistent;
        }
        ReassemblyOutcome::Message { bytes, reserved }
    }

    /// Records that the other end has sent all messages below `next`. `since` is the time at which this became known.
    pub(crate) fn note_sent(&mut self, next: u64, since: MonoTime) {
        self.extend(next, since);
        let first_new = self.sent_below.max(self.floor);
        if next <= first_new {
            return;
        }
        let newly_sent = (first_new - self.floor) as usize..(next - self.floor) as usize;
        for slot in self.slots.range_mut(newly_sent) {
            if let Slot::Unfinished(unfinished) = slot {
                unfinished.sent_at.get_or_insert(since);
            }
        }
        self.sent_below = next;
    }

    /// Creates the states of all messages below `next`. If these are more than [`MAX_SPAN`], gives up the messages with
    /// the lowest numbers.
    fn extend(&mut self, next: u64, now: MonoTime) {
        if next > self.floor.saturating_add(MAX_SPAN) {
            let floor = next - MAX_SPAN;
            while self.floor < floor
                && let Some(slot) = self.slots.pop_front()
            {
                // Numbers without any fragment are skipped, so that a sender that leaves out many numbers does not make
                // this end report each of them.
                if let Slot::Unfinished(unfinished) = slot {
                    self.unfinished_count -= 1;
                    self.lost.push(unfinished.to_loss(self.floor));
                }
                self.floor += 1;
            }
            self.floor = self.floor.max(floor);
            self.advance_floor();
        }
        let slot_count = next.saturating_sub(self.floor) as usize;
        while self.slots.len() < slot_count {
            self.slots.push_back(Slot::Missing { since: now });
        }
    }

    /// Gives up messages whose time limit has passed.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        let ReassemblyLimits { timeout, idle_timeout, .. } = self.limits;
        let next = self.sent_below;
        self.give_up(|sequence, slot| match slot {
            Slot::Missing { since } => sequence < next && now - *since >= timeout,
            Slot::Unfinished(unfinished) => {
                let UnfinishedMessage { deadline, progress_at, sent_at, .. } = **unfinished;
                let is_overdue = match sent_at {
                    // Counted from the last fragment, because further fragments may still be on their way.
                    Some(sent_at) => now - sent_at.max(progress_at) >= timeout,
                    None => now - progress_at >= idle_timeout,
                };
                is_overdue || deadline.is_some_and(|deadline| deadline <= now)
            }
            Slot::Settled => false,
        });
    }

    /// Gives up all unfinished messages, and all missing messages that are known to have been sent.
    pub(crate) fn give_up_all(&mut self) {
        let next = self.sent_below;
        self.give_up(|sequence, slot| sequence < next || matches!(slot, Slot::Unfinished(_)));
    }

    /// Gives up all messages for which `is_expired` returns `true`.
    fn give_up(&mut self, is_expired: impl Fn(u64, &Slot) -> bool) {
        for (index, slot) in self.slots.iter_mut().enumerate() {
            let sequence = self.floor + index as u64;
            if !is_expired(sequence, slot) {
                continue;
            }
            match std::mem::replace(slot, Slot::Settled) {
                Slot::Missing { .. } => {
                    self.lost.push(LostMessage { sequence, tag: None, received: 0, total: 0 });
                }
                Slot::Unfinished(unfinished) => {
                    self.unfinished_count -= 1;
                    self.lost.push(unfinished.to_loss(sequence));
                }
                Slot::Settled => {}
            }
        }
        self.advance_floor();
    }

    /// Gives up the unfinished message with the lowest number.
    fn give_up_oldest(&mut self) {
        let oldest = self.slots.iter().position(|slot| matches!(slot, Slot::Unfinished(_)));
        if let Some(index) = oldest
            && let Slot::Unfinished(unfinished) = std::mem::replace(&mut self.slots[index], Slot::Settled)
        {
            self.unfinished_count -= 1;
            self.lost.push(unfinished.to_loss(self.floor + index as u64));
            self.advance_floor();
        }
    }

    /// Gives up an unfinished message.
    fn give_up_slot(&mut self, sequence: u64) {
        let index = (sequence - self.floor) as usize;
        if let Some(slot) = self.slots.get_mut(index)
            && let Slot::Unfinished(unfinished) = std::mem::replace(slot, Slot::Settled)
        {
            self.unfinished_count -= 1;
            self.lost.push(unfinished.to_loss(sequence));
            self.advance_floor();
        }
    }

    /// Moves the floor up to the first number that is not settled.
    fn advance_floor(&mut self) {
        while let Some(Slot::Settled) = self.slots.front() {
            self.slots.pop_front();
            self.floor += 1;
        }
    }
}

impl UnfinishedMessage {
    /// Adds a fragment to its message.
    ///
    /// # Errors
    /// If the fragment would exceed the budget.
    fn add(
        &mut self,
        fragment: &Fragment<'_>,
        budget: &Arc<MemoryBudget>,
        now: MonoTime,
    ) -> Result<ReassemblyOutcome, BudgetExhausted> {
        let is_consistent = (fragment.tag, fragment.checksum, fragment.stride)
            == (self.tag, self.checksum, self.stride)
            && fragment.total_bytes == self.message.total_bytes();
        if !is_consistent {
            return Ok(ReassemblyOutcome::Inconsistent);
        }
        // Equal strides and aligned offsets exclude overlaps.
        let added = self.message.add(fragment.offset, fragment.bytes, budget);
        if added == Ok(AddOutcome::Duplicate) {
            return Ok(ReassemblyOutcome::Duplicate);
        }
        self.received_fragments += 1;
        self.progress_at = now;
        added.map(|_| ReassemblyOutcome::Stored)
    }

    fn to_loss(&self, sequence: u64) -> LostMessage {
        LostMessage {
            sequence,
            tag: Some(self.tag),
            received: self.received_fragments,
            total: self.total_fragments,
        }
    }
}

#[cfg(test)]
mod tests;
