//! Queue of messages that wait to be sent.

use std::collections::VecDeque;

use peernet_clock::MonoTime;

use crate::transport::datagram::fragment::OutgoingMessage;

/// Limits of a send queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct QueueLimits {
    /// Maximum number of messages.
    pub(crate) max_messages: usize,
    /// Maximum number of bytes. An empty queue accepts a message of any size.
    pub(crate) max_bytes: u64,
}

/// Messages in the order of their numbers. Only the first message may have been sent in part.
#[derive(Debug)]
pub(super) struct SendQueue {
    limits: QueueLimits,
    messages: VecDeque<OutgoingMessage>,
    /// Number of bytes of the queued messages that remain to be sent.
    remaining_bytes: u64,
}

impl SendQueue {
    pub(super) const fn new(limits: QueueLimits) -> Self {
        Self { limits, messages: VecDeque::new(), remaining_bytes: 0 }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.messages.is_empty()
    }

    /// Returns whether a message of `bytes` bytes may be queued.
    pub(super) fn accepts(&self, bytes: u64) -> bool {
        let is_full = self.messages.len() >= self.limits.max_messages
            || self.remaining_bytes + bytes > self.limits.max_bytes;
        self.messages.is_empty() || !is_full
    }

    /// Queues a message even if the limits are exceeded.
    pub(super) fn push(&mut self, message: OutgoingMessage) {
        self.remaining_bytes += u64::from(message.remaining());
        self.messages.push_back(message);
    }

    /// Returns the message whose part is sent next.
    pub(super) fn front(&self) -> Option<&OutgoingMessage> {
        self.messages.front()
    }

    /// Appends at most `max_bytes` of the next bytes of the first message to `out`. Returns the number of the message
    /// and the offset in the message at which these bytes end.
    pub(super) fn take(&mut self, max_bytes: u16, out: &mut Vec<u8>) -> Option<(u64, u32)> {
        let message = self.messages.front_mut()?;
        let (_, fragment_bytes) = message.take(max_bytes, out);
        self.remaining_bytes -= u64::from(fragment_bytes);
        let end = (message.sequence, message.offset);
        if message.is_done() {
            self.messages.pop_front();
        }
        Some(end)
    }

    /// Drops the remainder of the first message.
    pub(super) fn drop_front(&mut self) {
        if let Some(message) = self.messages.pop_front() {
            self.remaining_bytes -= u64::from(message.remaining());
        }
    }

    /// Drops the messages whose deadline has passed. Returns their numbers.
    pub(super) fn expire(&mut self, now: MonoTime) -> Vec<u64> {
        let (mut expired, remaining_bytes) = (Vec::new(), &mut self.remaining_bytes);
        self.messages.retain(|message| {
            let is_pending = message.deadline.is_none_or(|deadline| now < deadline);
            if !is_pending {
                *remaining_bytes -= u64::from(message.remaining());
                expired.push(message.sequence);
            }
            is_pending
        });
        expired
    }
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;
    use peernet_clock::Span;

    use super::*;

    fn message(sequence: u64, size: usize, deadline: Option<MonoTime>) -> OutgoingMessage {
        OutgoingMessage::new(vec![Bytes::from(vec![7; size])], sequence, 0, deadline)
            .expect("the message is small")
    }

    #[test]
    fn queued_bytes_change_with_queued_taken_and_expired_messages() {
        let time_at = |millis| MonoTime::default() + Span::from_millis(millis);
        let mut queue = SendQueue::new(QueueLimits { max_messages: 3, max_bytes: 1_000 });
        assert!(queue.accepts(5_000), "an empty queue accepts a message of any size");
        // The wire form adds six bytes to each message.
        queue.push(message(0, 94, None));
        queue.push(message(1, 494, Some(time_at(10))));
        assert!(queue.accepts(400) && !queue.accepts(401));
        assert_eq!(queue.take(60, &mut Vec::new()), Some((0, 60)));
        assert!(queue.accepts(460) && !queue.accepts(461));
        assert_eq!((queue.expire(time_at(9)), queue.expire(time_at(10))), (vec![], vec![1]));
        assert!(queue.accepts(960) && !queue.accepts(961));
        assert_eq!(queue.take(60, &mut Vec::new()), Some((0, 100)));
        assert!(queue.is_empty() && queue.front().is_none());
        queue.push(message(2, 94, None));
        queue.push(message(3, 94, None));
        queue.take(60, &mut Vec::new());
        queue.drop_front();
        assert_eq!(queue.front().map(|message| message.sequence), Some(3));
        assert!(queue.accepts(900) && !queue.accepts(901));
        queue.drop_front();
        assert_eq!(queue.take(60, &mut Vec::new()), None);
    }

    #[test]
    fn number_of_messages_is_bounded() {
        let mut queue = SendQueue::new(QueueLimits { max_messages: 2, max_bytes: 1_000 });
        queue.push(message(0, 1, None));
        assert!(queue.accepts(1));
        queue.push(message(1, 1, None));
        assert!(!queue.accepts(1));
    }
}
