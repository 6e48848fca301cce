//! Publishers of ROS 2 topics.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use futures::FutureExt;
use peernet_clock::WallTime;
use rustdds::dds::{WriteError, WriteResult};
use rustdds::no_key::DataWriter;
use rustdds::{SampleIdentity, WriteOptions, WriteOptionsBuilder};
use tokio::sync::watch;

use super::conversions::timestamp;
use super::endpoint::Endpoint;
use super::raw_message::{RawAdapter, RawMessage};
use crate::ros2::{EndpointId, PeerTable, QosProfile, Ros2Error};

/// A publisher of a topic.
pub struct Ros2Publisher {
    // Dropped before the endpoint, which then removes the publisher from the node list.
    pub(super) writer: DataWriter<RawMessage, RawAdapter>,
    pub(super) endpoint: Endpoint,
    pub(super) qos: QosProfile,
    /// Number of bytes that were published since all messages were acknowledged, or were treated as acknowledged by
    /// [`forget_unacknowledged`](Self::forget_unacknowledged). It is approximate if several tasks publish at once.
    pub(super) unacknowledged_bytes: AtomicUsize,
    /// Largest value of `unacknowledged_bytes`.
    pub(super) max_unacknowledged_bytes: usize,
}

impl Ros2Publisher {
    /// Maximum number of unacknowledged bytes, unless half of this host's receive buffer is smaller. A single message
    /// may be larger. Bytes that do not fit into the receive buffer of a peer are lost, and repairing several large
    /// messages between `rustdds` and Fast DDS fails. Cyclone DDS requests a receive buffer of this size.
    pub(super) const MAX_UNACKNOWLEDGED_BYTES: usize = 1 << 20;

    /// Returns the identity of the publisher, which subscriptions receive with each message.
    pub fn id(&self) -> EndpointId {
        self.endpoint.id
    }

    /// Returns the absolute name of the topic.
    pub fn topic(&self) -> &str {
        &self.endpoint.topic
    }

    /// Returns a receiver of the subscriptions of the topic and their changes.
    pub fn peers(&self) -> watch::Receiver<PeerTable> {
        self.endpoint.peers.clone()
    }

    /// Waits for a subscription of the topic.
    ///
    /// # Errors
    ///
    /// [`Ros2Error::NoPeer`] if no subscription is found within `time_limit`; the error says what was
    /// tried.
    pub async fn wait_for_peer(&self, time_limit: Duration) -> Result<(), Ros2Error> {
        self.endpoint.wait_for_peer(time_limit).await
    }

    /// Publishes a message and returns its sequence number. The payload begins with the encapsulation header (`00 01 00
    /// 00`) and is sent without being copied.
    ///
    /// A reliable publisher waits while 1,024 messages (or more, if [`depth`](QosProfile::depth) is larger) are
    /// unacknowledged. It also waits while the unacknowledged bytes with this message would exceed 1 MiB or half of
    /// this host's receive buffer, whichever is less. Subscriptions receive `source_time` as the time of publishing.
    ///
    /// # Errors
    ///
    /// - [`Ros2Error::NotCdr`] if the payload does not begin with the header.
    /// - [`Ros2Error::PublishTimeout`] if the limits are still exceeded after
    ///   [`max_blocking_ms`](QosProfile::max_blocking_ms).
    /// - [`Ros2Error::ShutDown`] after the node was shut down.
    pub async fn publish(&self, payload: Bytes, source_time: WallTime) -> Result<i64, Ros2Error> {
        let topic = || self.endpoint.topic.clone();
        let message =
            RawMessage::from_payload(payload).ok_or_else(|| Ros2Error::NotCdr { topic: topic() })?;
        let options = WriteOptionsBuilder::new().source_timestamp(timestamp(source_time)).build();
        let write = self.write(message, options);
        // The write of rustdds has a time limit, but the future is not woken when the limit is reached.
        let waited = Duration::from_millis(u64::from(self.qos.max_blocking_ms));
        let in_time = tokio::time::timeout(waited, write);
        match self.endpoint.node.closed.run_until_cancelled(in_time).await {
            None => Err(self.endpoint.shut_down_error()),
            Some(Ok(Ok(identity))) => Ok(i64::from(identity.sequence_number)),
            Some(Err(_) | Ok(Err(WriteError::WouldBlock { .. }))) => Err(Ros2Error::PublishTimeout {
                topic: topic(),
                waited,
                peers: self.endpoint.peers.borrow().matched.len(),
            }),
            Some(Ok(Err(error))) => {
                Err(Ros2Error::Publish { topic: topic(), reason: error.forget_data().to_string() })
            }
        }
    }

    /// Publishes a message as [`publish`](Self::publish) does, but never waits. Returns `None` if it would wait.
    ///
    /// # Errors
    ///
    /// Those of `publish`, except `PublishTimeout`.
    pub fn try_publish(&self, payload: Bytes, source_time: WallTime) -> Result<Option<i64>, Ros2Error> {
        let topic = || self.endpoint.topic.clone();
        if self.endpoint.node.closed.is_cancelled() {
            return Err(self.endpoint.shut_down_error());
        }
        let message =
            RawMessage::from_payload(payload).ok_or_else(|| Ros2Error::NotCdr { topic: topic() })?;
        let options = WriteOptionsBuilder::new().source_timestamp(timestamp(source_time)).build();
        match self.write(message, options).now_or_never() {
            None | Some(Err(WriteError::WouldBlock { .. })) => Ok(None),
            Some(Ok(identity)) => Ok(Some(i64::from(identity.sequence_number))),
            Some(Err(error)) => {
                Err(Ros2Error::Publish { topic: topic(), reason: error.forget_data().to_string() })
            }
        }
    }

    /// Treats all messages so far as acknowledged, so that a slow subscription does not delay later messages. `rustdds`
    /// still keeps the messages that the subscription has not received.
    pub fn forget_unacknowledged(&self) {
        self.unacknowledged_bytes.store(0, Ordering::Relaxed);
    }

    async fn write(
        &self,
        message: RawMessage,
        options: WriteOptions,
    ) -> WriteResult<SampleIdentity, RawMessage> {
        let size = message.0.len();
        if self.unacknowledged_bytes.load(Ordering::Relaxed).saturating_add(size)
            > self.max_unacknowledged_bytes
            && self.unacknowledged_bytes.load(Ordering::Relaxed) > 0
        {
            // The error is ignored, because the write below then fails as well.
            let _acknowledged = self.writer.async_wait_for_acknowledgments().await;
            self.unacknowledged_bytes.store(0, Ordering::Relaxed);
        }
        let identity = self.writer.async_write_with_options(message, options).await?;
        self.unacknowledged_bytes.fetch_add(size, Ordering::Relaxed);
        Ok(identity)
    }

    /// Waits until all matched reliable subscriptions have acknowledged all published messages.
    ///
    /// # Errors
    ///
    /// [`Ros2Error::Unacknowledged`] if not all messages are acknowledged within `time_limit`.
    pub async fn wait_for_acknowledgment(&self, time_limit: Duration) -> Result<(), Ros2Error> {
        let acknowledged = tokio::time::timeout(time_limit, self.writer.async_wait_for_acknowledgments());
        match self.endpoint.node.closed.run_until_cancelled(acknowledged).await {
            None => Err(self.endpoint.shut_down_error()),
            Some(Ok(Ok(true))) => Ok(()),
            Some(Err(_) | Ok(Ok(false))) => {
                Err(Ros2Error::Unacknowledged { topic: self.endpoint.topic.clone(), waited: time_limit })
            }
            Some(Ok(Err(error))) => {
                Err(Ros2Error::Publish { topic: self.endpoint.topic.clone(), reason: error.to_string() })
            }
        }
    }
}
