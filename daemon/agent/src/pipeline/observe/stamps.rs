//! Stamps of received messages, for this host and for peers that query them.

use std::sync::Arc;

use peernet_clock::SharedClock;

use super::message::TopicMessage;
use crate::link::{EpochWatch, HostStamp};
use crate::observed::{ObservedPipeline, Side};

/// Stamps received messages, and publishes the stamps if peers may query them.
#[derive(Debug)]
pub(super) struct MessageStamps {
    clock: SharedClock,
    epochs: EpochWatch,
    published: Option<Arc<ObservedPipeline>>,
}

impl MessageStamps {
    pub(super) fn new(clock: SharedClock, published: Option<Arc<ObservedPipeline>>) -> Self {
        Self { epochs: EpochWatch::new(&*clock), clock, published }
    }

    /// Returns the stamp of a message that was received a moment ago, and publishes it under `key`.
    pub(super) fn stamp(&mut self, side: Side, message: &TopicMessage, key: Option<i64>) -> HostStamp {
        let stamp = self.epochs.stamp(&*self.clock, message.received_at);
        if let (Some(published), Some(key)) = (&self.published, key) {
            published.record(side, key, stamp, message.received_at.mono);
        }
        stamp
    }
}
