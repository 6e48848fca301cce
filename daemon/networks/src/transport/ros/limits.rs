//! Limits of the messages of a connection.

use std::any::Any;
use std::sync::Arc;

use peernet_clock::Span;
use peernet_ros::ros1::{MemoryLimit, QueueLimits, SubscriberOptions, WhenFull};

use super::connection::ConnectionLimits;
use super::interface::SessionNode;
use crate::SessionSettings;
use crate::transport::memory::{MemoryBudget, Reservation};

/// Time limit for the payload of a companion, or the companion of a payload. Both may be in transfer on a slow link.
const PAIRING_TIMEOUT: Span = Span::from_seconds(30);

/// Maximum number of bytes of queued messages on a topic. A single longer message is accepted.
const MAX_QUEUED_BYTES: usize = 64 * 1024;

/// Largest size of a companion without its frames. Bytes.
pub(super) const INFO_OVERHEAD_BYTES: usize = 4 * 1024;

/// Returns the limits of a connection.
pub(super) fn connection_limits(settings: &SessionSettings, node: &dyn SessionNode) -> ConnectionLimits {
    ConnectionLimits {
        max_message_bytes: settings.max_message_bytes,
        // One for each request in flight, and 16 for the messages that open and close sessions.
        max_incomplete: settings.max_in_flight as usize + 16,
        confirms_payloads: node.is_connectionless(),
        pairing_timeout: node.payload_timeout().map_or(PAIRING_TIMEOUT, Span::from),
        heartbeat_interval: settings.heartbeat_interval().into(),
        heartbeat_timeout: settings.heartbeat_timeout().into(),
    }
}

/// Returns the length of the longest message on a topic. Bytes.
pub(super) fn max_topic_message_bytes(settings: &SessionSettings) -> usize {
    usize::try_from(settings.max_message_bytes).unwrap_or(usize::MAX).saturating_add(INFO_OVERHEAD_BYTES)
}

/// Limits of the messages that the peer may send.
#[derive(Clone, Debug)]
pub(super) struct ReceiveLimits {
    /// Largest message on a topic. Bytes.
    pub(super) max_message_bytes: usize,
    /// Memory that all received messages share, from their first bytes until they are handed to the layer above.
    pub(super) budget: Arc<MemoryBudget>,
}

impl ReceiveLimits {
    /// Returns the options of a subscription. The queue of the subscription is short, so that further messages wait at
    /// the publisher.
    pub(super) fn subscriber_options(
        &self,
        settings: &SessionSettings,
        publisher: &Arc<str>,
    ) -> SubscriberOptions {
        SubscriberOptions {
            queue: QueueLimits { messages: queue_limits(settings).messages, bytes: MAX_QUEUED_BYTES },
            when_full: WhenFull::Wait,
            max_message_bytes: self.max_message_bytes,
            publisher: Some(Arc::clone(publisher)),
            memory: self.memory(),
        }
    }

    /// Returns the budget for the ROS client.
    pub(super) fn memory(&self) -> Option<Arc<dyn MemoryLimit>> {
        Some(Arc::new(BudgetLimit(Arc::clone(&self.budget))))
    }
}

/// A budget with the interface that the ROS client uses.
#[derive(Debug)]
struct BudgetLimit(Arc<MemoryBudget>);

impl MemoryLimit for BudgetLimit {
    fn reserve(&self, bytes: usize) -> Option<Box<dyn Any + Send + Sync>> {
        let mut reserved = Reservation::empty(&self.0);
        reserved.resize(&self.0, bytes as u64).ok()?;
        Some(Box::new(reserved))
    }
}

/// Returns the limits of the queue of a published topic: one message for each request in flight, and 32 for the
/// messages that open, maintain and close a connection.
pub(super) fn queue_limits(settings: &SessionSettings) -> QueueLimits {
    QueueLimits { messages: settings.max_in_flight as usize + 32, bytes: max_topic_message_bytes(settings) }
}
