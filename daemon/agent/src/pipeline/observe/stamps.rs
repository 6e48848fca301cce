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
    /// The stamps that peers may query; `None` if peers cannot query this pipeline.
    published_stamps: Option<Arc<ObservedPipeline>>,
}

impl MessageStamps {
    pub(super) fn new(clock: SharedClock, published_stamps: Option<Arc<ObservedPipeline>>) -> Self {
        Self { epochs: EpochWatch::new(&*clock), clock, published_stamps }
    }

    /// Returns the stamp of a message that was received a moment ago, and publishes it under `key`.
    pub(super) fn stamp(&mut self, side: Side, message: &TopicMessage, key: Option<i64>) -> HostStamp {
        let stamp = self.epochs.stamp(&*self.clock, message.received_at);
        if let (Some(published_stamps), Some(key)) = (&self.published_stamps, key) {
            published_stamps.record(side, key, stamp, message.received_at.mono);
        }
        stamp
    }
}
