//! Stamps of received messages, for this host and for agents that ask.

use std::sync::Arc;

use peernet_clock::SharedClock;

use super::message::TopicMessage;
use crate::link::{EpochWatch, HostStamp};
use crate::observed::{ObservedPipeline, Side};

/// Stamps received messages, and keeps the stamps if peers may ask for them.
#[derive(Debug)]
pub(super) struct MessageStamps {
    clock: SharedClock,
    epochs: EpochWatch,
    kept: Option<Arc<ObservedPipeline>>,
}

impl MessageStamps {
    pub(super) fn new(clock: SharedClock, kept: Option<Arc<ObservedPipeline>>) -> Self {
        Self { epochs: EpochWatch::new(&*clock), clock, kept }
    }

    /// Returns the stamp of a message that was received a moment ago, and keeps it under `key`.
    pub(super) fn take(&mut self, side: Side, message: &TopicMessage, key: Option<i64>) -> HostStamp {
        let stamp = self.epochs.stamp(&*self.clock, message.received);
        if let (Some(kept), Some(key)) = (&self.kept, key) {
            kept.note(side, key, stamp, message.received.mono);
        }
        stamp
    }
}
