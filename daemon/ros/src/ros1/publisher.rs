//! Publishers of topics.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::net::TcpStream;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use super::error::NodeError;
use super::limits::QueueLimits;
use super::outgoing::{FullQueuePolicy, OfferOutcome, OutgoingConnection, SendCounts};
use super::registration_guard::RegistrationGuard;
use super::tcpros::{ConnectionHeader, Publication};
use crate::messages::EncodedMessage;

/// Options of a publisher.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublisherOptions {
    /// `true` if a new subscriber gets the last message at once.
    pub is_latching: bool,
    /// Limits of each subscriber's queue.
    pub queue: QueueLimits,
}

/// Result of publishing a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublishOutcome {
    /// Number of subscribers to which the message is sent, or in whose queue it waits.
    pub subscribers: usize,
    /// Number of subscribers that do not get the message because their queue was full.
    pub dropped: usize,
}

/// Result of publishing a message for one subscriber.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// The message is sent, or waits in the subscriber's queue.
    Accepted,
    /// The subscriber does not get the message because its queue was full.
    Full,
    /// The subscriber is not connected.
    NotConnected,
}

/// State of the connection to a subscriber, with counts of its messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SubscriberStatus {
    /// Name of the subscriber's node.
    pub node: Arc<str>,
    /// Address of this end of the connection.
    pub local: SocketAddr,
    /// Address of the subscriber's end of the connection.
    pub remote: SocketAddr,
    /// Counts of messages and bytes.
    pub counts: SendCounts,
}

/// Publishes a topic. Dropping it ends the connections to subscribers and unregisters the topic.
#[derive(Debug)]
pub struct Publisher {
    pub(super) topic: Arc<PublishedTopic>,
    pub(super) guard: RegistrationGuard,
}

impl Publisher {
    /// Returns the global name of the topic.
    pub fn topic(&self) -> &str {
        &self.topic.publication.topic
    }

    /// Publishes a message. Never waits. A subscriber whose queue is full does not get the message; the outcome and the
    /// counts have the number of these subscribers.
    ///
    /// # Errors
    /// If the node has ended, or the message has more than 2³² − 1 bytes.
    pub fn publish(&self, message: impl Into<EncodedMessage>) -> Result<PublishOutcome, NodeError> {
        let (message, prefix) = self.check_message(message.into())?;
        let connections = self.topic.start_publishing(&message, prefix);
        let mut outcome = PublishOutcome::default();
        for connection in connections {
            match connection.offer(&message, prefix, FullQueuePolicy::Drop) {
                OfferOutcome::Accepted => outcome.subscribers += 1,
                OfferOutcome::Full => outcome.dropped += 1,
                OfferOutcome::Closed => {}
            }
        }
        Ok(outcome)
    }

    /// Publishes a message as [`publish`](Self::publish) does. Returns the outcome for the subscriber of one node.
    ///
    /// # Errors
    /// Those of `publish`.
    pub fn publish_to(&self, node: &str, message: impl Into<EncodedMessage>) -> Result<Delivery, NodeError> {
        let (message, prefix) = self.check_message(message.into())?;
        let mut delivery = Delivery::NotConnected;
        for connection in self.topic.start_publishing(&message, prefix) {
            let offer_outcome = connection.offer(&message, prefix, FullQueuePolicy::Drop);
            if *connection.subscriber == *node {
                delivery = match offer_outcome {
                    OfferOutcome::Accepted => Delivery::Accepted,
                    OfferOutcome::Full => Delivery::Full,
                    // A node that has reconnected has two connections until the older one is removed.
                    OfferOutcome::Closed => delivery,
                };
            }
        }
        Ok(delivery)
    }

    /// Returns whether the queue for the subscriber of one node is too full for a message of `length` bytes.
    pub fn is_full_for(&self, node: &str, length: usize) -> bool {
        // The list is copied, so that the topic is not locked while messages are written to sockets.
        let connections = self.topic.state().connections.clone();
        connections.iter().any(|connection| *connection.subscriber == *node && connection.is_full(length))
    }

    /// Publishes a message and waits until each subscriber's queue has accepted it. Nothing is dropped while a
    /// subscriber is connected, and the slowest subscriber determines the rate.
    ///
    /// # Errors
    /// If the node has ended, or the message has more than 2³² − 1 bytes.
    pub async fn publish_waiting(
        &self,
        message: impl Into<EncodedMessage>,
    ) -> Result<PublishOutcome, NodeError> {
        let (message, prefix) = self.check_message(message.into())?;
        let connections = self.topic.start_publishing(&message, prefix);
        let mut outcome = PublishOutcome::default();
        for connection in connections {
            outcome.subscribers += usize::from(connection.offer_until_accepted(&message, prefix).await);
        }
        Ok(outcome)
    }

    /// Waits until `count` subscribers are connected.
    ///
    /// # Errors
    /// If the node has ended.
    pub async fn wait_for_subscribers(&self, count: usize) -> Result<(), NodeError> {
        loop {
            // The future is created before the connections are checked, so that no change in between is missed.
            let connection_added = self.topic.connection_added.notified();
            self.guard.check_open()?;
            if self.topic.state().connections.len() >= count {
                return Ok(());
            }
            tokio::select! {
                () = connection_added => {}
                () = self.topic.stop.cancelled() => {}
            }
        }
    }

    /// Returns the connected subscribers.
    pub fn subscribers(&self) -> Vec<SubscriberStatus> {
        self.topic.subscribers()
    }

    /// Returns the sums over all subscribers, including subscribers that have left.
    pub fn counts(&self) -> SendCounts {
        self.topic.counts()
    }

    fn check_message(&self, message: EncodedMessage) -> Result<(EncodedMessage, [u8; 4]), NodeError> {
        self.guard.check_open()?;
        let length = message.len();
        match u32::try_from(length) {
            Ok(length_u32) => Ok((message, length_u32.to_le_bytes())),
            Err(_) => Err(NodeError::MessageTooLong { topic: self.topic().to_owned(), length }),
        }
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.topic.stop.cancel();
    }
}

/// A topic that a node publishes.
#[derive(Debug)]
pub(super) struct PublishedTopic {
    pub(super) publication: Publication,
    limits: QueueLimits,
    /// Token that ends the connections.
    pub(super) stop: CancellationToken,
    state: Mutex<TopicState>,
    /// Notified when a connection was added.
    connection_added: Notify,
}

#[derive(Debug, Default)]
struct TopicState {
    connections: Vec<Arc<OutgoingConnection>>,
    /// Last message of a latching topic, and its length prefix.
    latched_message: Option<(EncodedMessage, [u8; 4])>,
    /// Counts of the connections that have ended.
    ended_counts: SendCounts,
}

impl PublishedTopic {
    pub(super) fn new(publication: Publication, limits: QueueLimits, stop: CancellationToken) -> Self {
        Self { publication, limits, stop, state: Mutex::default(), connection_added: Notify::new() }
    }

    fn state(&self) -> MutexGuard<'_, TopicState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Stores the message for later subscribers if the topic is latching. Returns the connections on which the message
    /// must be sent.
    fn start_publishing(&self, message: &EncodedMessage, prefix: [u8; 4]) -> Vec<Arc<OutgoingConnection>> {
        // The lock is held until the list is copied, so that a new subscriber gets a latched message exactly once.
        let mut state = self.state();
        if self.publication.is_latching {
            state.latched_message = Some((message.clone(), prefix));
        }
        // The list is copied, so that the topic is not locked while messages are written to sockets.
        state.connections.clone()
    }

    pub(super) fn subscribers(&self) -> Vec<SubscriberStatus> {
        let connections = self.state().connections.clone();
        let status = |connection: &Arc<OutgoingConnection>| SubscriberStatus {
            node: Arc::clone(&connection.subscriber),
            local: connection.local,
            remote: connection.remote,
            counts: connection.counts(),
        };
        connections.iter().map(status).collect()
    }

    pub(super) fn counts(&self) -> SendCounts {
        let state = self.state();
        // The lock is held during the sum, so that a connection that ends meanwhile is counted exactly once.
        let mut sum = state.ended_counts;
        state.connections.iter().for_each(|connection| sum.add(&connection.counts()));
        sum
    }

    /// Sends `answer` to a subscriber, and then messages until the connection ends.
    pub(super) async fn run_connection(
        &self,
        stream: TcpStream,
        subscriber: Arc<str>,
        answer: ConnectionHeader,
    ) {
        let connection = match OutgoingConnection::new(stream, subscriber, self.limits) {
            Ok(connection) => Arc::new(connection),
            Err(error) => {
                tracing::debug!(%error, "a ROS subscriber disconnected");
                return;
            }
        };
        {
            let mut state = self.state();
            if let Some((message, prefix)) = &state.latched_message {
                connection.offer(message, *prefix, FullQueuePolicy::Drop);
            }
            // The connection is added before the answer is sent. Otherwise the subscriber would miss a message that is
            // published just after the subscriber has read the answer.
            state.connections.push(Arc::clone(&connection));
        }
        self.connection_added.notify_waiters();
        connection.run(&answer.encode(), &self.stop).await;
        let mut state = self.state();
        state.connections.retain(|other| !Arc::ptr_eq(other, &connection));
        // A concurrent call of publish may still offer a message; a closed queue refuses it without counting it.
        state.ended_counts.add(&connection.counts());
    }
}
