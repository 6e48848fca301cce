//! Streams with a deferred batch: the queue had no capacity for the batch when the batch arrived.

use std::collections::{BTreeSet, VecDeque};

use super::StreamId;

/// Deferred streams in the order in which they were deferred. Each stream is in the list once.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct DeferredStreams {
    order: VecDeque<StreamId>,
    members: BTreeSet<StreamId>,
}

impl DeferredStreams {
    pub(super) const fn new() -> Self {
        Self { order: VecDeque::new(), members: BTreeSet::new() }
    }

    pub(super) fn push(&mut self, stream: StreamId) {
        if self.members.insert(stream) {
            self.order.push_back(stream);
        }
    }

    /// Removes and returns the stream that waits longest.
    pub(super) fn pop(&mut self) -> Option<StreamId> {
        let stream = self.order.pop_front()?;
        self.members.remove(&stream);
        Some(stream)
    }

    pub(super) fn remove(&mut self, stream: StreamId) {
        if self.members.remove(&stream) {
            self.order.retain(|other| *other != stream);
        }
    }
}
