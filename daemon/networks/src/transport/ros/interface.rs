//! Interface to both versions of ROS for sessions: a node, its publishers and its subscribers. Code that uses this
//! interface does not depend on the version.

#[cfg(test)]
pub(super) mod test_node;

use std::fmt::Debug;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use peernet_ros::messages::{EncodedMessage, WireForm};
use peernet_ros::ros1::{
    Delivery, EnvironmentError, MemoryLimit, MessageMemory, NodeError, QueueLimits, SubscriberOptions,
    TopicType,
};

use super::names::TopicPair;
use super::ros1::Ros1Node;
use super::ros2::Ros2SessionNode;
use crate::{Address, SessionSettings};

/// Opens a node of the version that the address's scheme selects.
pub(super) async fn open_node(
    address: &Address,
    name: &str,
    settings: &SessionSettings,
    clock: &SharedClock,
) -> Result<Arc<dyn SessionNode>, NodeFailure> {
    Ok(match address.ros_domain() {
        None => Arc::new(Ros1Node::open(address, name, clock).await?),
        Some(_) => Arc::new(Ros2SessionNode::open(address, name, settings, clock).await?),
    })
}

/// Error: an operation on a node failed, for this reason.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub(super) struct NodeFailure(pub(super) String);

impl From<NodeError> for NodeFailure {
    fn from(error: NodeError) -> Self {
        Self(error.to_string())
    }
}

impl From<EnvironmentError> for NodeFailure {
    fn from(error: EnvironmentError) -> Self {
        Self(error.to_string())
    }
}

/// Another node from which messages arrive.
#[derive(Clone, Debug)]
pub(super) struct RemoteNode {
    /// Name of the node, which it also states when it asks for a connection.
    pub(super) node: Arc<str>,
    /// Address of this end of the path to the node.
    pub(super) local: SocketAddr,
    /// Address of the other node's host.
    pub(super) remote: SocketAddr,
}

/// A message that arrived on a topic.
#[derive(Debug)]
pub(super) struct TopicMessage {
    /// The message as it was sent.
    pub(super) bytes: Bytes,
    pub(super) publisher: RemoteNode,
    /// Type of the message, such as `sensor_msgs/Image`.
    pub(super) type_name: Arc<str>,
    /// Reservation of the message's memory in the subscriber's limit.
    pub(super) memory: MessageMemory,
}

/// Purpose of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TopicPurpose {
    /// Requests for connections.
    Sessions,
    /// Refusals of requests for connections.
    Refusals,
    /// Companions: messages that carry the frames of one message, except for a payload that is published on its own
    /// topic.
    Companions,
    /// Payloads, which other programs may display.
    Payloads,
}

/// Topics of a connection that an edge opens.
#[derive(Clone, Debug)]
pub(super) struct EdgeTopics {
    /// Name of the cloud.
    pub(super) cloud: String,
    pub(super) request: TopicPair,
    pub(super) response: TopicPair,
    /// Common prefix of the names of all nodes of this pipeline.
    pub(super) node_name_prefix: String,
}

/// A node of either version of ROS.
pub(super) trait SessionNode: Debug + Send + Sync {
    /// Returns the serialization of messages.
    fn form(&self) -> WireForm;

    /// Returns the name by which the other end recognizes messages of this node.
    fn name(&self) -> &str;

    /// Returns the readable names of the programs behind a node; empty if they are unknown.
    fn readable_names(&self, node: &str) -> Vec<String> {
        vec![node.to_owned()]
    }

    /// Returns a description of another node for people, such as `node /viewer`. `node` is the name by which its
    /// messages are recognized.
    fn describe(&self, node: &str) -> String;

    /// Returns the global name of a topic or of a pipeline.
    fn resolve(&self, name: &str) -> Result<String, NodeFailure>;

    /// Checks that the cloud exists, and that no other program uses the topics. Returns the name of the cloud's node.
    fn find_cloud_and_check_topics<'a>(
        &'a self,
        topics: &'a EdgeTopics,
    ) -> BoxFuture<'a, Result<Arc<str>, NodeFailure>>;

    /// Checks that no other cloud has the name `cloud`.
    fn check_cloud_name<'a>(&'a self, cloud: &'a str) -> BoxFuture<'a, Result<(), NodeFailure>>;

    /// Returns the size of this node's socket buffers, in bytes. The other end does not send longer payload messages.
    /// `None` if payloads of any length arrive, as in ROS 1.
    fn receive_buffer_bytes(&self) -> Option<usize>;

    /// Returns whether publishers and subscribers have no connections between them, as in ROS 2. A publisher then does
    /// not know which nodes receive its messages, so the other end must confirm that messages arrive.
    fn is_connectionless(&self) -> bool {
        // Only messages over TCP connections, which ROS 1 uses, may be longer than the buffers.
        self.receive_buffer_bytes().is_some()
    }

    /// Returns the maximum number of bytes of frames in one companion.
    fn max_companion_bytes(&self) -> usize;

    /// Returns the time limit for a payload whose companion has arrived; `None` for the default.
    fn payload_timeout(&self) -> Option<Duration>;

    /// Returns a warning about a limit of this host that slows connections down, such as small socket buffers, and what
    /// to do about it.
    fn caveat(&self) -> Option<&str>;

    /// Publishes a topic.
    fn publish<'a>(
        &'a self,
        topic: &'a str,
        kind: (TopicPurpose, TopicType),
        queue: QueueLimits,
    ) -> BoxFuture<'a, Result<Box<dyn SessionPublisher>, NodeFailure>>;

    /// Subscribes to a topic. Payloads may have any type.
    fn subscribe<'a>(
        &'a self,
        topic: &'a str,
        kind: (TopicPurpose, TopicType),
        options: SubscriberOptions,
    ) -> BoxFuture<'a, Result<Box<dyn SessionSubscriber>, NodeFailure>>;

    /// Ends the node after all published messages have been sent, or after `time_limit`.
    fn end(&self, time_limit: Duration) -> BoxFuture<'_, ()>;

    /// Ends the node at once.
    fn close(&self);
}

/// Publishes a topic until it is dropped.
pub(super) trait SessionPublisher: Debug + Send + Sync {
    /// Returns the global name of the topic.
    fn topic(&self) -> &str;

    /// Publishes a message to all subscribers. Never waits.
    fn publish(&self, message: EncodedMessage) -> Result<(), NodeFailure>;

    /// Publishes the fragments of one message to all subscribers, each as [`publish`](Self::publish) does. Returns the
    /// outcome for the subscriber of `node`.
    fn publish_fragments(&self, node: &str, fragments: &[EncodedMessage]) -> Result<Delivery, NodeFailure>;

    /// Returns whether the queue for the subscriber of `node` is too full for a message of `length` bytes.
    fn is_full(&self, node: &str, length: usize) -> bool;

    /// Returns why `node` receives nothing although it subscribes to the topic, with advice; `None` if no reason is
    /// known.
    fn describe_mismatch(&self, node: &str) -> Option<String>;
}

/// Receives a topic until it is dropped.
pub(super) trait SessionSubscriber: Debug + Send {
    /// Returns the global name of the topic.
    fn topic(&self) -> &str;

    /// Waits for the next message. Cancel safe: dropping the future loses nothing.
    fn recv(&mut self) -> BoxFuture<'_, Result<TopicMessage, NodeFailure>>;

    /// Returns the next message if one has arrived.
    fn try_recv(&mut self) -> Option<TopicMessage>;

    /// Returns whether a node has a publisher whose messages this subscriber receives.
    fn is_connected(&self, node: &str) -> bool;

    /// Returns the nodes that publish the topic, but whose messages this subscriber rejects.
    fn rejected_publishers(&self) -> Vec<Arc<str>> {
        Vec::new()
    }

    /// Returns a view of the publishers that can be used while a message is awaited.
    fn watch(&self) -> Box<dyn PublisherChanges>;

    /// Changes the limits of messages that are received from now on.
    fn set_message_limits(&self, max_message_bytes: usize, memory: Option<Arc<dyn MemoryLimit>>);
}

/// A view of the publishers of a topic.
pub(super) trait PublisherChanges: Send + Sync {
    /// Returns a future that ends when the publishers have changed since this call.
    fn changed(&self) -> BoxFuture<'_, ()>;
}

/// Ends a node in the background, because the caller cannot wait.
pub(super) fn end_in_background(node: Arc<dyn SessionNode>, time_limit: Duration) {
    match tokio::runtime::Handle::try_current() {
        Ok(runtime) => {
            runtime.spawn(async move { node.end(time_limit).await });
        }
        // Outside a runtime, nothing can send the remaining messages in the background.
        Err(_) => node.close(),
    }
}
