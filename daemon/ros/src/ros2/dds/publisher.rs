//! Publishing to a topic.

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
    // The writer goes first: the node list is told when it has gone.
    pub(super) writer: DataWriter<RawMessage, RawAdapter>,
    pub(super) endpoint: Endpoint,
    pub(super) qos: QosProfile,
    /// Bytes that were published since everything was acknowledged, roughly where several tasks publish at once.
    pub(super) unacknowledged: AtomicUsize,
    /// Bytes that may be.
    pub(super) most_unacknowledged: usize,
}

impl Ros2Publisher {
    /// Bytes that may be unacknowledged, or half of the receive buffer where that is less; a single message may be larger. What
    /// does not fit into the receive buffer of a peer is lost, and repairing several large messages between `rustdds` and Fast DDS
    /// does not succeed. Cyclone DDS asks for a receive buffer of this size.
    pub(super) const MAX_UNACKNOWLEDGED_BYTES: usize = 1 << 20;

    /// Identity of the publisher, which subscriptions receive with each message.
    pub fn id(&self) -> EndpointId {
        self.endpoint.id
    }

    /// Absolute name of the topic.
    pub fn topic(&self) -> &str {
        &self.endpoint.topic
    }

    /// Subscriptions of the topic that are there, and changes of them.
    pub fn peers(&self) -> watch::Receiver<PeerTable> {
        self.endpoint.peers.clone()
    }

    /// Waits until a subscription of the topic is there.
    ///
    /// # Errors
    ///
    /// [`Ros2Error::NoPeer`] says what was tried when there is none in time.
    pub async fn await_peer(&self, patience: Duration) -> Result<(), Ros2Error> {
        self.endpoint.await_peer(patience).await
    }

    /// Publishes a message and returns its sequence number. The payload begins with the encapsulation header
    /// (`00 01 00 00`) and is sent without being copied.
    ///
    /// A reliable publisher waits while 1,024 messages (or more, if [`depth`](QosProfile::depth) is) or 1 MiB are
    /// unacknowledged.
    /// `source_time` is what subscriptions see as the time of publishing.
    ///
    /// # Errors
    ///
    /// [`Ros2Error::NotCdr`] for a payload without the header, [`Ros2Error::PublishTimeout`] when there is no room
    /// within [`max_blocking_ms`](QosProfile::max_blocking_ms), [`Ros2Error::ShutDown`] after the node was shut down.
    pub async fn publish(&self, payload: Bytes, source_time: WallTime) -> Result<i64, Ros2Error> {
        let topic = || self.endpoint.topic.clone();
        let message =
            RawMessage::from_payload(payload).ok_or_else(|| Ros2Error::NotCdr { topic: topic() })?;
        let options = WriteOptionsBuilder::new().source_timestamp(timestamp(source_time)).build();
        let written = self.write(message, options);
        // The write of rustdds has a time limit of its own but is not woken when it is reached.
        let waited = Duration::from_millis(u64::from(self.qos.max_blocking_ms));
        let in_time = tokio::time::timeout(waited, written);
        match self.endpoint.node.closed.run_until_cancelled(in_time).await {
            None => Err(self.endpoint.shut_down()),
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

    /// As [`publish`](Self::publish) without waiting. Returns `None` when there is no room.
    ///
    /// # Errors
    ///
    /// As those of `publish`, but for the time limit.
    pub fn try_publish(&self, payload: Bytes, source_time: WallTime) -> Result<Option<i64>, Ros2Error> {
        let topic = || self.endpoint.topic.clone();
        if self.endpoint.node.closed.is_cancelled() {
            return Err(self.endpoint.shut_down());
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

    /// Counts everything so far as acknowledged, so that a slow subscription does not stop others messages.
    /// Messages that it lacks are kept for it as before.
    pub fn forget_unacknowledged(&self) {
        self.unacknowledged.store(0, Ordering::Relaxed);
    }

    async fn write(
        &self,
        message: RawMessage,
        options: WriteOptions,
    ) -> WriteResult<SampleIdentity, RawMessage> {
        let size = message.0.len();
        if self.unacknowledged.load(Ordering::Relaxed).saturating_add(size) > self.most_unacknowledged
            && self.unacknowledged.load(Ordering::Relaxed) > 0
        {
            // Fails for reasons only for which the write fails as well.
            let _acknowledged = self.writer.async_wait_for_acknowledgments().await;
            self.unacknowledged.store(0, Ordering::Relaxed);
        }
        let identity = self.writer.async_write_with_options(message, options).await?;
        self.unacknowledged.fetch_add(size, Ordering::Relaxed);
        Ok(identity)
    }

    /// Waits until all matched reliable subscriptions have everything that was published.
    ///
    /// # Errors
    ///
    /// [`Ros2Error::Unacknowledged`] when they have not in time.
    pub async fn await_acknowledgment(&self, patience: Duration) -> Result<(), Ros2Error> {
        let acknowledged = tokio::time::timeout(patience, self.writer.async_wait_for_acknowledgments());
        match self.endpoint.node.closed.run_until_cancelled(acknowledged).await {
            None => Err(self.endpoint.shut_down()),
            Some(Ok(Ok(true))) => Ok(()),
            Some(Err(_) | Ok(Ok(false))) => {
                Err(Ros2Error::Unacknowledged { topic: self.endpoint.topic.clone(), waited: patience })
            }
            Some(Ok(Err(error))) => {
                Err(Ros2Error::Publish { topic: self.endpoint.topic.clone(), reason: error.to_string() })
            }
        }
    }
}
