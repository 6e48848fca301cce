//! Bounds of the messages of a connection.

use std::any::Any;
use std::sync::Arc;

use peernet_clock::Span;
use peernet_ros::ros1::{MemoryLimit, QueueLimits, SubscriberOptions, WhenFull};

use super::connection::ConnectionLimits;
use super::interface::SessionNode;
use crate::SessionSettings;
use crate::transport::memory::{MemoryBudget, Reservation};

/// Timeout of the other half of a message: both may be under way on a slow link.
const PAIRING_TIMEOUT: Span = Span::from_seconds(30);

/// Bytes of the messages on a topic that wait to be taken, unless it is a single longer one.
const WAITING_BYTES: usize = 64 * 1024;

/// Bytes of a companion beside its frames.
pub(super) const INFO_OVERHEAD_BYTES: usize = 4 * 1024;

/// Returns the bounds of a connection.
pub(super) fn connection_limits(settings: &SessionSettings, node: &dyn SessionNode) -> ConnectionLimits {
    ConnectionLimits {
        max_message_bytes: settings.max_message_bytes,
        max_incomplete: settings.max_in_flight as usize + 16,
        confirms_payloads: node.receive_buffer_bytes().is_some(),
        pairing_timeout: node.payload_patience().map_or(PAIRING_TIMEOUT, Span::from),
        heartbeat_interval: settings.heartbeat_interval().into(),
        heartbeat_timeout: settings.heartbeat_timeout().into(),
    }
}

/// Returns the bytes of the longest message on a topic.
pub(super) fn largest_message(settings: &SessionSettings) -> usize {
    usize::try_from(settings.max_message_bytes).unwrap_or(usize::MAX).saturating_add(INFO_OVERHEAD_BYTES)
}

/// Bounds of the messages that the peer may send.
#[derive(Clone, Debug)]
pub(super) struct ReceiveLimits {
    /// Longest message on a topic. Bytes.
    pub(super) max_message_bytes: usize,
    /// Memory that all received messages share, from their first bytes until they are handed up.
    pub(super) budget: Arc<MemoryBudget>,
}

impl ReceiveLimits {
    /// Returns the options of a subscription: it holds few bytes before they are taken, and more stays with the publisher.
    pub(super) fn subscriber_options(
        &self,
        settings: &SessionSettings,
        publisher: &Arc<str>,
    ) -> SubscriberOptions {
        SubscriberOptions {
            queue: QueueLimits { messages: queue_limits(settings).messages, bytes: WAITING_BYTES },
            when_full: WhenFull::Wait,
            max_message_bytes: self.max_message_bytes,
            publisher: Some(Arc::clone(publisher)),
            memory: self.memory(),
        }
    }

    /// Returns the budget for the client of ROS.
    pub(super) fn memory(&self) -> Option<Arc<dyn MemoryLimit>> {
        Some(Arc::new(ReceivingMemory(Arc::clone(&self.budget))))
    }
}

/// A budget as the client of ROS asks it.
#[derive(Debug)]
struct ReceivingMemory(Arc<MemoryBudget>);

impl MemoryLimit for ReceivingMemory {
    fn reserve(&self, bytes: usize) -> Option<Box<dyn Any + Send + Sync>> {
        let mut reserved = Reservation::empty(&self.0);
        reserved.set(&self.0, bytes as u64).ok()?;
        Some(Box::new(reserved))
    }
}

/// Bounds of the queue of a topic that is published: it has room for every request in flight, and for the messages that open, keep
/// and close a connection.
pub(super) fn queue_limits(settings: &SessionSettings) -> QueueLimits {
    QueueLimits { messages: settings.max_in_flight as usize + 32, bytes: largest_message(settings) }
}
