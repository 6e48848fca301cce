//! Queue of received messages for the owner of a subscriber.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use peernet_clock::Stamp;
use tokio::sync::Notify;

use super::limits::QueueLimits;
use super::memory::MessageMemory;
use super::subscriber::PublisherInfo;

/// A received message of a topic.
#[derive(Debug)]
pub struct ReceivedMessage {
    /// Bytes of the message, to be decoded with [`Message::decode`](crate::messages::Message::decode).
    pub bytes: Bytes,
    /// Publisher of the message.
    pub publisher: Arc<PublisherInfo>,
    /// Time at which the last byte of the message was read.
    pub received: Stamp,
    /// Memory that is reserved for the message within the subscriber's limit
    /// [`memory`](crate::ros1::SubscriberOptions::memory).
    pub memory: MessageMemory,
}

/// Policy for a message that arrives while the queue is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenFull {
    /// Reading pauses, so that the publisher's queue fills and the publisher decides which messages to drop. This
    /// queue loses no message.
    #[default]
    Wait,
    /// The new message is dropped and counted, which the publisher does not notice. Suitable for observers, because a
    /// subscriber that stops reading can stall a robot's node.
    Drop,
    /// The oldest messages in the queue are dropped and counted until the new message fits. Suitable for consumers
    /// of the newest message.
    DropOldest,
}

/// Queue of the messages of all publishers of a topic.
#[derive(Debug)]
pub(super) struct IncomingQueue {
    limits: QueueLimits,
    when_full: WhenFull,
    queue: Mutex<Queue>,
    message_added: Notify,
    space_freed: Notify,
}

#[derive(Debug, Default)]
struct Queue {
    messages: VecDeque<ReceivedMessage>,
    bytes: usize,
}

impl IncomingQueue {
    pub(super) fn new(limits: QueueLimits, when_full: WhenFull) -> Self {
        Self {
            limits,
            when_full,
            queue: Mutex::default(),
            message_added: Notify::new(),
            space_freed: Notify::new(),
        }
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a message. Returns the number of messages that were dropped because the queue was full.
    pub(super) async fn push(&self, mut message: ReceivedMessage) -> u64 {
        let mut dropped = 0;
        loop {
            // The future is created before the queue is checked, so that no change in between is missed.
            let space_freed = self.space_freed.notified();
            match self.try_push(message) {
                None => return dropped,
                Some(_) if self.when_full == WhenFull::Drop => return dropped + 1,
                Some(rejected) => message = rejected,
            }
            if self.when_full == WhenFull::DropOldest {
                // The owner may have removed a message in the meantime, so there may be space already.
                dropped += u64::from(self.try_pop().is_some());
                continue;
            }
            space_freed.await;
        }
    }

    /// Adds a message. Returns the message if the queue is full.
    fn try_push(&self, message: ReceivedMessage) -> Option<ReceivedMessage> {
        let mut queue = self.queue();
        let length = message.bytes.len();
        if !self.limits.accepts(queue.messages.len(), queue.bytes, length) {
            return Some(message);
        }
        queue.bytes += length;
        queue.messages.push_back(message);
        drop(queue);
        self.message_added.notify_one();
        None
    }

    /// Removes and returns the oldest message, or waits for one.
    pub(super) async fn pop(&self) -> ReceivedMessage {
        loop {
            if let Some(message) = self.try_pop() {
                return message;
            }
            // A message that arrived in the meantime has left a permit.
            self.message_added.notified().await;
        }
    }

    /// Removes and returns the oldest message.
    pub(super) fn try_pop(&self) -> Option<ReceivedMessage> {
        let mut queue = self.queue();
        let message = queue.messages.pop_front()?;
        queue.bytes -= message.bytes.len();
        drop(queue);
        // All waiting tasks are woken, because several messages may fit in the space of a long message.
        self.space_freed.notify_waiters();
        Some(message)
    }
}
