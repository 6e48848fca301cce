//! Subscriber with a task that reads messages from `rustdds` as they arrive, because `rustdds` soon drops unread
//! messages.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use futures::FutureExt;
use futures::future::BoxFuture;
use peernet_ros::messages::{CompressedImage, Image, Message, UInt8MultiArray};
use peernet_ros::ros1::{MemoryLimit, MessageMemory, SubscriberOptions};
use peernet_ros::ros2::{
    DiscoveredEndpoint, EndpointId, EndpointRole, ParticipantId, QosProfile, Ros2Node, Ros2Subscription,
};
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, watch};
use tokio_util::task::AbortOnDropHandle;

use super::remote::remote_node;
use super::{PublisherNames, ros2_type_name};
use crate::transport::ros::interface::{
    NodeFailure, PublisherChanges, RemoteNode, SessionSubscriber, TopicMessage,
};

/// Maximum number of bytes of queued messages. Further messages are dropped, because a ROS 2 publisher cannot be slowed
/// down.
const MAX_QUEUED_BYTES: usize = 128 * 1024 * 1024;

/// Maximum number of queued messages.
const MAX_QUEUED_MESSAGES: usize = 8_192;

/// Maximum number of publishers that have sent messages and that discovery has not found yet.
const MAX_UNMATCHED_WRITERS: usize = 64;

/// Receives a topic.
pub(super) struct Ros2SessionSubscriber {
    topic: String,
    messages: mpsc::Receiver<Result<TopicMessage, NodeFailure>>,
    publishers: PublisherNames,
    limits: Arc<SubscriberLimits>,
    /// Failure that [`SessionSubscriber::try_recv`] took from the queue, for the next call of `recv`.
    failure: Option<NodeFailure>,
    _task: AbortOnDropHandle<()>,
}

#[derive(Debug, Default)]
struct SubscriberLimits {
    max_message_bytes: AtomicUsize,
    queued_bytes: AtomicUsize,
}

/// Reason why a subscription ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SubscriptionEnd {
    /// The subscriber was dropped, or the subscription failed.
    Closed,
    /// There are only publishers of another type.
    TypeChanged,
}

/// State of a subscriber's task.
struct SubscriberTask {
    node: Arc<Ros2Node>,
    topic: String,
    /// Participant of the peer, if it is known. If the subscriber takes any type, the type is taken from the publishers
    /// of this participant. Messages of other participants are received as well; the connection drops them.
    expected_publisher: Option<Arc<str>>,
    takes_any_type: bool,
    messages: mpsc::Sender<Result<TopicMessage, NodeFailure>>,
    publishers: watch::Sender<BTreeSet<Arc<str>>>,
    limits: Arc<SubscriberLimits>,
    /// Participants whose messages arrived.
    remote_nodes: BTreeMap<ParticipantId, RemoteNode>,
}

impl Ros2SessionSubscriber {
    /// Receives the messages of a subscription.
    pub(super) fn from_subscription(
        node: &Arc<Ros2Node>,
        subscription: Ros2Subscription,
        type_name: Arc<str>,
        options: &SubscriberOptions,
    ) -> Self {
        let topic = subscription.topic().to_owned();
        Self::start(node, topic, options, |mut task| async move {
            task.run(subscription, type_name).await;
        })
    }

    /// Receives messages of the type that the publisher gives the topic, once discovery has found the publisher.
    pub(super) fn with_any_type(
        node: &Arc<Ros2Node>,
        topic: &str,
        qos: QosProfile,
        options: &SubscriberOptions,
    ) -> Self {
        Self::start(node, topic.to_owned(), options, |mut task| async move {
            task.takes_any_type = true;
            // The next connection of a pipeline may give its topic another type.
            loop {
                let type_name = task.payload_type().await;
                match task.node.create_subscription(&task.topic, &ros2_type_name(type_name), &qos) {
                    Ok(subscription) => {
                        if task.run(subscription, type_name.into()).await == SubscriptionEnd::Closed {
                            return;
                        }
                    }
                    Err(error) => return task.fail(error.into()).await,
                }
            }
        })
    }

    fn start<F: Future<Output = ()> + Send + 'static>(
        node: &Arc<Ros2Node>,
        topic: String,
        options: &SubscriberOptions,
        run: impl FnOnce(SubscriberTask) -> F,
    ) -> Self {
        let ((sender, messages), (publisher_names, publishers)) =
            (mpsc::channel(MAX_QUEUED_MESSAGES), watch::channel(BTreeSet::new()));
        let limits = Arc::new(SubscriberLimits::default());
        limits.max_message_bytes.store(options.max_message_bytes, Ordering::Relaxed);
        let task = SubscriberTask {
            node: Arc::clone(node),
            topic: topic.clone(),
            expected_publisher: options.publisher.clone(),
            takes_any_type: false,
            messages: sender,
            publishers: publisher_names,
            limits: Arc::clone(&limits),
            remote_nodes: BTreeMap::new(),
        };
        let handle = AbortOnDropHandle::new(tokio::spawn(run(task)));
        Self { topic, messages, publishers, limits, failure: None, _task: handle }
    }

    /// Returns a message that was taken from the queue, and subtracts its bytes from the queued bytes.
    fn release_memory(
        &self,
        message: Result<TopicMessage, NodeFailure>,
    ) -> Result<TopicMessage, NodeFailure> {
        let bytes = message.as_ref().map_or(0, |message| message.bytes.len());
        self.limits.queued_bytes.fetch_sub(bytes, Ordering::Relaxed);
        message
    }
}

impl SubscriberTask {
    /// Returns the types of payloads that the publisher gives the topic at present.
    fn payload_types(&self) -> Vec<&'static str> {
        let types =
            [Image::DEFINITION.name, CompressedImage::DEFINITION.name, UInt8MultiArray::DEFINITION.name];
        let is_from_publisher = |endpoint: &&DiscoveredEndpoint| {
            let publisher_id = self.expected_publisher.as_deref();
            endpoint.role == EndpointRole::Publisher
                && publisher_id
                    .is_none_or(|publisher_id| endpoint.id.participant().to_string() == publisher_id)
        };
        let endpoints = self.node.endpoints_of(&self.topic);
        let endpoints = endpoints.iter().filter(is_from_publisher);
        endpoints
            .filter_map(|endpoint| types.into_iter().find(|kind| ros2_type_name(kind) == endpoint.type_name))
            .collect()
    }

    /// Waits for a publisher of payloads. Returns the type that it gives the topic.
    async fn payload_type(&self) -> &'static str {
        let mut changes = self.node.discovery_changes();
        loop {
            if let Some(kind) = self.payload_types().pop() {
                return kind;
            }
            if changes.changed().await.is_err() {
                // Discovery has ended. The task is aborted with its subscriber.
                std::future::pending::<()>().await;
            }
        }
    }

    /// Receives until there are only publishers of another type, or until the subscriber is dropped.
    async fn run(&mut self, mut subscription: Ros2Subscription, type_name: Arc<str>) -> SubscriptionEnd {
        let mut peers = subscription.peers();
        // Messages may arrive before discovery finds their publisher, even after discovery has reported that the
        // previous publisher is gone.
        let mut unmatched_writers: BTreeSet<EndpointId> = BTreeSet::new();
        loop {
            let (matched, has_refused_publisher) = {
                let peers = peers.borrow_and_update();
                (peers.matched.clone(), !peers.refused.is_empty())
            };
            if matched.is_empty() && has_refused_publisher && self.takes_any_type {
                let types = self.payload_types();
                if !types.is_empty() && !types.contains(&&*type_name) {
                    return SubscriptionEnd::TypeChanged;
                }
            }
            unmatched_writers.retain(|id| !matched.contains(id));
            let names: BTreeSet<Arc<str>> = matched
                .iter()
                .chain(&unmatched_writers)
                .map(|id| self.remote_node(id.participant()).node)
                .collect();
            self.publishers.send_if_modified(|current| {
                let is_changed = *current != names;
                *current = names;
                is_changed
            });
            let message = tokio::select! {
                message = subscription.receive() => message,
                changed = peers.changed() => match changed {
                    Ok(()) => continue,
                    Err(_) => return SubscriptionEnd::Closed,
                },
            };
            let message = match message {
                Ok(message) => message,
                Err(error) => {
                    self.fail(error.into()).await;
                    return SubscriptionEnd::Closed;
                }
            };
            if !matched.contains(&message.writer) && unmatched_writers.len() < MAX_UNMATCHED_WRITERS {
                unmatched_writers.insert(message.writer);
            }
            let (bytes, queued_bytes) =
                (message.payload.len(), self.limits.queued_bytes.load(Ordering::Relaxed));
            let max_message_bytes = self.limits.max_message_bytes.load(Ordering::Relaxed);
            // A ROS 2 publisher cannot be slowed down, and the queue must not grow without limit.
            if bytes > max_message_bytes || queued_bytes.saturating_add(bytes) > MAX_QUEUED_BYTES {
                tracing::debug!(
                    topic = subscription.topic(),
                    bytes,
                    waiting = queued_bytes,
                    "dropped a ROS 2 message: it is too long, or too many messages are queued"
                );
                continue;
            }
            self.limits.queued_bytes.fetch_add(bytes, Ordering::Relaxed);
            let publisher = self.remote_node(message.writer.participant());
            let memory = MessageMemory::default();
            let received =
                TopicMessage { bytes: message.payload, publisher, type_name: Arc::clone(&type_name), memory };
            match self.messages.try_send(Ok(received)) {
                Ok(()) => {}
                Err(TrySendError::Full(_)) => {
                    self.limits.queued_bytes.fetch_sub(bytes, Ordering::Relaxed);
                    tracing::debug!(
                        topic = subscription.topic(),
                        bytes,
                        "dropped a ROS 2 message: too many messages are queued"
                    );
                }
                Err(TrySendError::Closed(_)) => return SubscriptionEnd::Closed,
            }
        }
    }

    fn remote_node(&mut self, id: ParticipantId) -> RemoteNode {
        self.remote_nodes.entry(id).or_insert_with(|| remote_node(&self.node, id)).clone()
    }

    /// Hands the failure of the subscription to the subscriber.
    async fn fail(&self, failure: NodeFailure) {
        // Sending fails if nothing receives messages any more.
        let _ = self.messages.send(Err(failure)).await;
    }
}

impl fmt::Debug for Ros2SessionSubscriber {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Ros2SessionSubscriber").field("topic", &self.topic).finish_non_exhaustive()
    }
}

impl SessionSubscriber for Ros2SessionSubscriber {
    fn topic(&self) -> &str {
        &self.topic
    }

    fn recv(&mut self) -> BoxFuture<'_, Result<TopicMessage, NodeFailure>> {
        let receive = async {
            if let Some(failure) = self.failure.take() {
                return Err(failure);
            }
            let ended = || Err(NodeFailure(format!("topic {} has ended", self.topic)));
            let message = self.messages.recv().await.unwrap_or_else(ended);
            self.release_memory(message)
        };
        receive.boxed()
    }

    fn try_recv(&mut self) -> Option<TopicMessage> {
        let message = self.messages.try_recv().ok()?;
        match self.release_memory(message) {
            Ok(message) => Some(message),
            Err(failure) => {
                self.failure = Some(failure);
                None
            }
        }
    }

    fn is_connected(&self, node: &str) -> bool {
        self.publishers.borrow().contains(node)
    }

    fn watch(&self) -> Box<dyn PublisherChanges> {
        let mut publishers = self.publishers.clone();
        // The view reports only changes that follow its creation.
        publishers.mark_unchanged();
        Box::new(WatchedPublishers(publishers))
    }

    // The memory limit is ignored: `rustdds` has none that could be set, and the connection reserves the memory later.
    fn set_message_limits(&self, max_message_bytes: usize, _memory: Option<Arc<dyn MemoryLimit>>) {
        self.limits.max_message_bytes.store(max_message_bytes, Ordering::Relaxed);
    }
}

struct WatchedPublishers(PublisherNames);

impl PublisherChanges for WatchedPublishers {
    fn changed(&self) -> BoxFuture<'_, ()> {
        let mut publishers = self.0.clone();
        let changed = async move {
            if publishers.changed().await.is_err() {
                // The subscriber has ended; its own `recv` returns the reason.
                std::future::pending::<()>().await;
            }
        };
        changed.boxed()
    }
}
