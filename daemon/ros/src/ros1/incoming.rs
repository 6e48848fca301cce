//! Received messages that wait for the owner of a subscriber.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use peernet_clock::Stamp;
use tokio::sync::Notify;

use super::limits::QueueLimits;
use super::memory::MessageMemory;
use super::subscriber::PublisherInfo;

/// A message of a topic.
#[derive(Debug)]
pub struct ReceivedMessage {
    /// The message as it was sent, to be read with [`Message::decode`](crate::messages::Message::decode).
    pub bytes: Bytes,
    /// Its publisher.
    pub publisher: Arc<PublisherInfo>,
    /// Time at which its last byte was read.
    pub received: Stamp,
    /// Memory that it takes of the subscriber's [`memory`](crate::ros1::SubscriberOptions::memory).
    pub memory: MessageMemory,
}

/// Policy for a message that finds the queue full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenFull {
    /// Reading pauses, so that the publisher's queue fills next and the publisher decides. Nothing is lost here.
    #[default]
    Wait,
    /// The message is dropped and counted. The publisher notices nothing, which suits those who only watch.
    Drop,
    /// The oldest messages in the queue are dropped and counted until it fits, which suits those who want the newest.
    DropOldest,
}

/// Messages of all publishers of a topic.
#[derive(Debug)]
pub(super) struct IncomingQueue {
    limits: QueueLimits,
    when_full: WhenFull,
    queue: Mutex<Queue>,
    arrived: Notify,
    room: Notify,
}

#[derive(Debug, Default)]
struct Queue {
    messages: VecDeque<ReceivedMessage>,
    bytes: usize,
}

impl IncomingQueue {
    pub(super) fn new(limits: QueueLimits, when_full: WhenFull) -> Self {
        Self { limits, when_full, queue: Mutex::default(), arrived: Notify::new(), room: Notify::new() }
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a message, and returns how many messages were dropped for want of room.
    pub(super) async fn push(&self, mut message: ReceivedMessage) -> u64 {
        let mut dropped = 0;
        loop {
            // Made before looking, so that nothing that happens in between is missed.
            let room = self.room.notified();
            match self.try_push(message) {
                None => return dropped,
                Some(_) if self.when_full == WhenFull::Drop => return dropped + 1,
                Some(refused) => message = refused,
            }
            if self.when_full == WhenFull::DropOldest {
                // Its owner may have read the oldest meanwhile; there is room then.
                dropped += u64::from(self.try_pop().is_some());
                continue;
            }
            room.await;
        }
    }

    /// Adds a message, or returns it if the queue is full.
    fn try_push(&self, message: ReceivedMessage) -> Option<ReceivedMessage> {
        let mut queue = self.queue();
        let length = message.bytes.len();
        if !self.limits.admit(queue.messages.len(), queue.bytes, length) {
            return Some(message);
        }
        queue.bytes += length;
        queue.messages.push_back(message);
        drop(queue);
        self.arrived.notify_one();
        None
    }

    /// Removes the oldest message, or waits for one.
    pub(super) async fn pop(&self) -> ReceivedMessage {
        loop {
            if let Some(message) = self.try_pop() {
                return message;
            }
            // A message that arrived since has left a permit.
            self.arrived.notified().await;
        }
    }

    /// Removes the oldest message.
    pub(super) fn try_pop(&self) -> Option<ReceivedMessage> {
        let mut queue = self.queue();
        let message = queue.messages.pop_front()?;
        queue.bytes -= message.bytes.len();
        drop(queue);
        self.room.notify_waiters();
        Some(message)
    }
}
