//! Subscribers of topics.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_clock::SharedClock;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::error::NodeError;
use super::incoming::{IncomingQueue, ReceivedMessage, WhenFull};
use super::lifetime::NodeLifetime;
use super::limits::{MAX_PUBLISHERS, QueueLimits};
use super::memory::{MemoryLimit, MessageLimits};
use super::publisher_link::PublisherLink;
use super::registration_guard::RegistrationGuard;
use super::tcpros::{Subscription, TopicType};

/// Options of a subscriber.
#[derive(Clone, Debug)]
pub struct SubscriberOptions {
    /// Limits of the queue of received messages.
    pub queue: QueueLimits,
    /// Policy for a message that arrives while the queue is full.
    pub when_full: WhenFull,
    /// Largest accepted message in bytes. A publisher of a larger message is disconnected.
    pub max_message_bytes: usize,
    /// Name of the only node whose messages are accepted; other publishers are disconnected before they send a message.
    /// By default messages of all nodes are accepted.
    pub publisher: Option<Arc<str>>,
    /// Limit on the memory of messages, from their first bytes until they are dropped; several subscribers may share
    /// it. A publisher whose message exceeds the limit is disconnected. By default there is no such limit.
    pub memory: Option<Arc<dyn MemoryLimit>>,
}

impl Default for SubscriberOptions {
    fn default() -> Self {
        Self {
            queue: QueueLimits::default(),
            when_full: WhenFull::default(),
            max_message_bytes: 64 * 1024 * 1024,
            publisher: None,
            memory: None,
        }
    }
}

/// Description of a publisher, from its connection header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PublisherInfo {
    /// Name of the publisher's node.
    pub node: Arc<str>,
    /// URI of that node's XML-RPC server.
    pub uri: Arc<str>,
    /// Type of the messages, including its definition.
    pub kind: TopicType,
    /// Address of this end of the connection.
    pub local: SocketAddr,
    /// Address of the publisher's end of the connection.
    pub remote: SocketAddr,
}

/// Counts of the messages from one publisher.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReceiveCounts {
    /// Messages that arrived completely, including dropped messages.
    pub messages: u64,
    /// Bytes of these messages, without the length prefixes.
    pub bytes: u64,
    /// Messages that were dropped because the subscriber's queue was full. With several publishers and
    /// [`WhenFull::DropOldest`], a dropped message is counted for the publisher of the message that replaced it.
    pub dropped: u64,
    /// Connections that were opened.
    pub connections: u64,
}

impl ReceiveCounts {
    fn add(&mut self, other: &Self) {
        self.messages += other.messages;
        self.bytes += other.bytes;
        self.dropped += other.dropped;
        self.connections += other.connections;
    }
}

/// State of the connection to a publisher.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PublisherState {
    /// The connection is being opened.
    Connecting,
    /// The connection is open.
    Connected(Arc<PublisherInfo>),
    /// The last attempt failed, or the connection broke, for this reason. The attempt is repeated.
    Failed(String),
}

/// A publisher of a topic that is subscribed to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PublisherStatus {
    /// URI of the XML-RPC server of the publisher's node.
    pub uri: Arc<str>,
    /// State of the connection.
    pub state: PublisherState,
    /// Counts of the publisher's messages.
    pub counts: ReceiveCounts,
    /// Name of the publisher's node, if its messages are rejected because it is not the node that
    /// [`SubscriberOptions::publisher`] names.
    pub rejected_node: Option<Arc<str>>,
}

/// Receives the messages of a topic from all its publishers. Dropping it ends the connections and unregisters the
/// topic.
#[derive(Debug)]
pub struct Subscriber {
    pub(super) topic: Arc<SubscribedTopic>,
    pub(super) guard: RegistrationGuard,
}

impl Subscriber {
    /// Returns the global name of the topic.
    pub fn topic(&self) -> &str {
        &self.topic.subscription.topic
    }

    /// Waits for the next message. Messages that arrived before the node ended are still returned.
    ///
    /// # Errors
    /// If the node has ended.
    pub async fn recv(&mut self) -> Result<ReceivedMessage, NodeError> {
        tokio::select! {
            // The choice is biased, so that messages that arrived before the end are returned before the error.
            biased;
            message = self.topic.queue.pop() => Ok(message),
            () = self.topic.stop.cancelled() => {
                // A message may have arrived after the queue was checked and before `stop` was checked.
                self.topic.queue.try_pop().ok_or_else(|| self.guard.closed_error())
            }
        }
    }

    /// Returns the next message if one has arrived.
    pub fn try_recv(&mut self) -> Option<ReceivedMessage> {
        self.topic.queue.try_pop()
    }

    /// Returns the publishers that the master lists or that are still connected. A caller that expects a single
    /// publisher can thus detect other publishers.
    pub fn publishers(&self) -> Vec<PublisherStatus> {
        self.topic.publishers()
    }

    /// Returns the sums over all publishers, including publishers that have left.
    pub fn counts(&self) -> ReceiveCounts {
        self.topic.counts()
    }

    /// Changes the limits [`max_message_bytes`](SubscriberOptions::max_message_bytes) and
    /// [`memory`](SubscriberOptions::memory). The new limits apply to the next bytes that arrive.
    pub fn set_message_limits(&self, max_message_bytes: usize, memory: Option<Arc<dyn MemoryLimit>>) {
        *self.topic.message_limits() = MessageLimits { max_bytes: max_message_bytes, memory };
    }

    /// Waits until `count` publishers are connected.
    ///
    /// # Errors
    /// If the node has ended.
    pub async fn wait_for_publishers(&self, count: usize) -> Result<(), NodeError> {
        loop {
            // The future is created before the publishers are checked, so that no change in between is missed.
            let changed = self.topic.changed.notified();
            self.guard.check_open()?;
            let is_connected =
                |publisher: &PublisherStatus| matches!(publisher.state, PublisherState::Connected(_));
            if self.publishers().iter().filter(|publisher| is_connected(publisher)).count() >= count {
                return Ok(());
            }
            tokio::select! {
                () = changed => {}
                () = self.topic.stop.cancelled() => {}
            }
        }
    }

    /// Returns a view of the publishers that can be used while a message is awaited.
    pub fn publisher_watch(&self) -> PublisherWatch {
        PublisherWatch(Arc::clone(&self.topic))
    }

    /// Returns a future that ends when the state of a connection to a publisher has changed since the future was made.
    pub fn publishers_changed(&self) -> impl Future<Output = ()> + '_ {
        self.topic.changed.notified()
    }
}

impl Drop for Subscriber {
    fn drop(&mut self) {
        self.topic.stop.cancel();
    }
}

/// A view of the publishers of a topic that is subscribed to.
#[derive(Clone, Debug)]
pub struct PublisherWatch(Arc<SubscribedTopic>);

impl PublisherWatch {
    /// Returns the publishers as [`Subscriber::publishers`] does.
    pub fn publishers(&self) -> Vec<PublisherStatus> {
        self.0.publishers()
    }

    /// Returns a future that ends when the state of a connection to a publisher has changed since the future was made.
    pub fn changed(&self) -> impl Future<Output = ()> + '_ {
        self.0.changed.notified()
    }
}

/// A topic that a node subscribes to.
#[derive(Debug)]
pub(super) struct SubscribedTopic {
    pub(super) subscription: Subscription,
    /// Name of the only node whose messages are accepted.
    pub(super) publisher: Option<Arc<str>>,
    message_limits: Mutex<MessageLimits>,
    pub(super) queue: IncomingQueue,
    pub(super) clock: SharedClock,
    pub(super) stop: CancellationToken,
    /// Notified when the state of a connection has changed.
    pub(super) changed: Notify,
    tasks: TaskTracker,
    state: Mutex<TopicState>,
}

#[derive(Debug, Default)]
struct TopicState {
    /// Connections to publishers, by the URIs of the publishers' nodes.
    links: BTreeMap<Arc<str>, Arc<PublisherLink>>,
    /// Counts of publishers that have been removed.
    ended_counts: ReceiveCounts,
}

impl SubscribedTopic {
    pub(super) fn new(
        subscription: Subscription,
        options: SubscriberOptions,
        clock: SharedClock,
        lifetime: &NodeLifetime,
    ) -> Self {
        Self {
            subscription,
            publisher: options.publisher,
            message_limits: Mutex::new(MessageLimits {
                max_bytes: options.max_message_bytes,
                memory: options.memory,
            }),
            queue: IncomingQueue::new(options.queue, options.when_full),
            clock,
            stop: lifetime.stop().child_token(),
            changed: Notify::new(),
            tasks: lifetime.tasks().clone(),
            state: Mutex::default(),
        }
    }

    fn state(&self) -> MutexGuard<'_, TopicState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn message_limits(&self) -> MutexGuard<'_, MessageLimits> {
        self.message_limits.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn publishers(&self) -> Vec<PublisherStatus> {
        self.state().links.values().map(|link| link.status()).collect()
    }

    pub(super) fn counts(&self) -> ReceiveCounts {
        let state = self.state();
        // The lock is held during the sum, so that a publisher that is removed meanwhile is counted exactly once.
        let mut sum = state.ended_counts;
        state.links.values().for_each(|link| sum.add(&link.status().counts));
        sum
    }

    /// Applies the master's list of publishers. Connections to publishers that are no longer listed remain until they
    /// break, because a restarted master has an empty list at first.
    pub(super) fn set_publishers(self: &Arc<Self>, uris: &[String]) {
        let mut state = self.state();
        for (uri, link) in &state.links {
            link.set_listed(uris.iter().any(|listed| **listed == **uri));
        }
        self.add_links(&mut state, uris);
    }

    /// Adds the publishers that the master's answer to a registration lists. No publisher is marked as unlisted,
    /// because the answer may be older than a list that the master has sent since.
    pub(super) fn add_publishers(self: &Arc<Self>, uris: &[String]) {
        self.add_links(&mut self.state(), uris);
    }

    fn add_links(self: &Arc<Self>, state: &mut TopicState, uris: &[String]) {
        for uri in uris {
            if let Some(link) = state.links.get(&**uri) {
                link.set_listed(true);
            } else if state.links.len() >= MAX_PUBLISHERS {
                let topic = &*self.subscription.topic;
                tracing::warn!(
                    topic,
                    uri,
                    "a ROS topic has more than {MAX_PUBLISHERS} publishers; ignoring this one"
                );
            } else {
                let uri: Arc<str> = uri.as_str().into();
                let link = Arc::new(PublisherLink::new(Arc::clone(&uri)));
                state.links.insert(uri, Arc::clone(&link));
                let topic = Arc::clone(self);
                self.tasks.spawn(async move { link.run(&topic).await });
            }
        }
        self.changed.notify_waiters();
    }

    /// Removes a publisher if the master does not list it any more or the subscriber stops. Returns whether the
    /// publisher was removed.
    pub(super) fn remove_if_ended(&self, link: &PublisherLink) -> bool {
        // The lock is taken before the check, so that a new list of the master cannot mark the publisher as listed
        // between the check and the removal.
        let mut state = self.state();
        if link.is_listed() && !self.stop.is_cancelled() {
            return false;
        }
        let counts = link.status().counts;
        state.links.remove(link.uri());
        state.ended_counts.add(&counts);
        drop(state);
        self.changed.notify_waiters();
        true
    }
}
