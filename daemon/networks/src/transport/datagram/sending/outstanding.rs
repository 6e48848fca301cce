//! Messages that the other end has not settled.

use std::collections::VecDeque;

use crate::transport::datagram::reassembly::MAX_SPAN;
use crate::transport::{Frames, MessageLoss};

/// A message that was sent or waits to be sent.
#[derive(Debug)]
pub(super) struct OutstandingMessage {
    /// Tag in its wire form: the tag plus one, 0 for none.
    pub(super) tag: u64,
    /// Number of fragments.
    pub(super) fragments: u32,
    /// Frames of the message, if it is retransmitted when it is lost.
    pub(super) retransmission: Option<Frames>,
    /// `true` if the message is known to be lost.
    pub(super) is_lost: bool,
}

/// The messages with the numbers from [`first_sequence`](Self::first_sequence) on, without a gap. There are at most
/// [`MAX_SPAN`], because the other end stores no more states.
#[derive(Debug, Default)]
pub(super) struct OutstandingMessages {
    first_sequence: u64,
    messages: VecDeque<OutstandingMessage>,
}

/// Returns the wire form of a tag, in which 0 means no tag.
pub(super) fn encode_tag(tag: Option<u64>) -> u64 {
    tag.map_or(0, |tag| tag.wrapping_add(1))
}

/// Returns the tag of a wire form.
pub(in crate::transport::datagram) fn decode_tag(encoded: u64) -> Option<u64> {
    encoded.checked_sub(1)
}

impl OutstandingMessages {
    /// Returns the number below which all messages are settled or too old to be reported.
    pub(super) const fn first_sequence(&self) -> u64 {
        self.first_sequence
    }

    /// Returns the number of the next message.
    pub(super) fn next_sequence(&self) -> u64 {
        self.first_sequence + self.messages.len() as u64
    }

    /// Adds a message, which gets the number [`next_sequence`](Self::next_sequence).
    pub(super) fn push(&mut self, tag: u64, fragments: u32, retransmission: Option<Frames>) {
        if self.messages.len() as u64 >= MAX_SPAN {
            self.messages.pop_front();
            self.first_sequence += 1;
        }
        self.messages.push_back(OutstandingMessage { tag, fragments, retransmission, is_lost: false });
    }

    /// Returns the message with this number unless it is settled.
    pub(super) fn get_mut(&mut self, sequence: u64) -> Option<&mut OutstandingMessage> {
        let index = usize::try_from(sequence.checked_sub(self.first_sequence)?).ok()?;
        self.messages.get_mut(index)
    }

    /// Removes the messages below a number. Returns the messages that arrived.
    pub(super) fn settle(&mut self, below: u64) -> impl Iterator<Item = OutstandingMessage> + '_ {
        let count = below.saturating_sub(self.first_sequence).min(self.messages.len() as u64);
        self.first_sequence += count;
        self.messages.drain(..count as usize).filter(|message| !message.is_lost)
    }

    /// Marks, as lost, a message that was dropped before it was sent completely. Returns the loss.
    pub(super) fn mark_lost(&mut self, sequence: u64) -> Option<MessageLoss> {
        let message = self.get_mut(sequence)?;
        message.is_lost = true;
        Some(MessageLoss { tag: decode_tag(message.tag), received: 0, total: message.fragments })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn message_numbers_continue_after_settled_messages() {
        let mut outstanding = OutstandingMessages::default();
        for tag in [None, Some(0), Some(7)] {
            outstanding.push(encode_tag(tag), 2, None);
        }
        let expired = MessageLoss { tag: Some(0), received: 0, total: 2 };
        assert_eq!(outstanding.mark_lost(1), Some(expired));
        assert_eq!(outstanding.mark_lost(3), None);
        assert_eq!(outstanding.settle(2).count(), 1, "the lost message did not arrive");
        assert_eq!((outstanding.first_sequence(), outstanding.next_sequence()), (2, 3));
        assert!(outstanding.get_mut(1).is_none());
        assert_eq!(outstanding.get_mut(2).and_then(|message| decode_tag(message.tag)), Some(7));
        assert_eq!(outstanding.settle(9).count(), 1);
        assert_eq!((outstanding.first_sequence(), outstanding.next_sequence()), (3, 3));
    }

    #[test]
    fn oldest_outstanding_message_is_dropped_when_full() {
        let mut outstanding = OutstandingMessages::default();
        for tag in 0..=MAX_SPAN {
            outstanding.push(tag, 1, None);
        }
        assert_eq!((outstanding.first_sequence(), outstanding.next_sequence()), (1, MAX_SPAN + 1));
        assert_eq!(outstanding.get_mut(1).map(|message| message.tag), Some(1));
    }
}
