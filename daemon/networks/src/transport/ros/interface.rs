//! Interface to both versions of ROS for sessions: a node, its publishers and its subscribers. Its users do not depend on the
//! version.

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

/// Opens a node of the version that the address's scheme says.
pub(super) async fn open_node(
    address: &Address,
    name: &str,
    settings: &SessionSettings,
    clock: &SharedClock,
) -> Result<Arc<dyn SessionNode>, NodeFailure> {
    Ok(match address.domain() {
        None => Arc::new(Ros1Node::open(address, name, clock).await?),
        Some(_) => Arc::new(Ros2SessionNode::open(address, name, settings, clock).await?),
    })
}

/// Something that could not be done, and why.
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

/// Another node, of which messages arrive.
#[derive(Clone, Debug)]
pub(super) struct RemoteNode {
    /// Its name, which it also gives itself when it asks for a connection.
    pub(super) node: Arc<str>,
    /// Own end of the way to it.
    pub(super) local: SocketAddr,
    /// The end of the other node's host.
    pub(super) remote: SocketAddr,
}

/// A message of a topic.
#[derive(Debug)]
pub(super) struct Received {
    /// The message as it was sent.
    pub(super) bytes: Bytes,
    pub(super) publisher: RemoteNode,
    /// Type of the message, as `sensor_msgs/Image`.
    pub(super) type_name: Arc<str>,
    /// Share of the subscriber's memory that the message takes.
    pub(super) memory: MessageMemory,
}

/// Purpose of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TopicUse {
    /// Requests for connections.
    Sessions,
    /// Companions of messages.
    Companions,
    /// Payloads, which other programs may want to see.
    Payloads,
}

/// The topics of a connection that an edge wants to open.
#[derive(Clone, Debug)]
pub(super) struct EdgeTopics {
    /// Name of the cloud.
    pub(super) cloud: String,
    pub(super) request: TopicPair,
    pub(super) response: TopicPair,
    /// Prefix of the names of all nodes of this pipeline.
    pub(super) own_prefix: String,
}

/// A node of either version.
pub(super) trait SessionNode: Debug + Send + Sync {
    /// Serialisation of messages.
    fn form(&self) -> WireForm;

    /// The name by which messages of this node are recognised at the other end.
    fn name(&self) -> &str;

    /// Returns the names that people gave the programs behind a node; none while they are not known.
    fn names(&self, node: &str) -> Vec<String> {
        vec![node.to_owned()]
    }

    /// Names another node for people, as `node /viewer`: `node` is how its messages are recognised.
    fn describe(&self, node: &str) -> String;

    /// Returns the global name of a topic or of a pipeline.
    fn resolve(&self, name: &str) -> Result<String, NodeFailure>;

    /// Checks that the cloud is there, and that no other program uses the topics. Returns the name of the cloud's node.
    fn find_cloud<'a>(&'a self, topics: &'a EdgeTopics) -> BoxFuture<'a, Result<Arc<str>, NodeFailure>>;

    /// Checks that no other cloud serves a name.
    fn check_cloud_name<'a>(&'a self, cloud: &'a str) -> BoxFuture<'a, Result<(), NodeFailure>>;

    /// Bytes that the sockets of this node hold before they are read; the other end sends no longer payload message. `None` where
    /// that has no limit: then the node also knows who receives its messages, and they need not say so.
    fn receive_buffer_bytes(&self) -> Option<usize>;

    /// Bytes of frames that one companion may have.
    fn max_companion_bytes(&self) -> usize;

    /// Timeout of a payload whose companion has arrived, if it is not the default.
    fn payload_patience(&self) -> Option<Duration>;

    /// A limit of this host that makes connections worse, such as small socket buffers, with its remedy.
    fn caveat(&self) -> Option<&str>;

    fn publish<'a>(
        &'a self,
        topic: &'a str,
        of: (TopicUse, TopicType),
        queue: QueueLimits,
    ) -> BoxFuture<'a, Result<Box<dyn SessionPublisher>, NodeFailure>>;

    /// Subscribes to a topic. Payloads may be of any type.
    fn subscribe<'a>(
        &'a self,
        topic: &'a str,
        of: (TopicUse, TopicType),
        options: SubscriberOptions,
    ) -> BoxFuture<'a, Result<Box<dyn SessionSubscriber>, NodeFailure>>;

    /// Ends the node, after what was published has gone out or `patience` has passed.
    fn end(&self, patience: Duration) -> BoxFuture<'_, ()>;

    /// Ends the node at once.
    fn close(&self);
}

/// Publishes a topic until it is dropped.
pub(super) trait SessionPublisher: Debug + Send + Sync {
    /// Global name of the topic.
    fn topic(&self) -> &str;

    /// Publishes a message for whoever subscribes, without waiting.
    fn publish(&self, message: EncodedMessage) -> Result<(), NodeFailure>;

    /// Publishes messages as [`publish`](Self::publish) does, and returns what became of them for one node.
    fn publish_to(&self, node: &str, messages: &[EncodedMessage]) -> Result<Delivery, NodeFailure>;

    /// Why a node subscribes to the topic and gets nothing, with what to do.
    fn refusal(&self, node: &str) -> Option<String>;
}

/// Receives a topic until it is dropped.
pub(super) trait SessionSubscriber: Debug + Send {
    /// Global name of the topic.
    fn topic(&self) -> &str;

    /// Waits for the next message. Dropping the future loses nothing.
    fn recv(&mut self) -> BoxFuture<'_, Result<Received, NodeFailure>>;

    /// Returns the next message if it is there.
    fn try_recv(&mut self) -> Option<Received>;

    /// Whether messages of a node arrive.
    fn is_connected(&self, node: &str) -> bool;

    /// Nodes that publish the topic as well, and whose messages never arrive here.
    fn other_publishers(&self) -> Vec<Arc<str>> {
        Vec::new()
    }

    /// Returns a view of the publishers that can be used while a message is awaited.
    fn watch(&self) -> Box<dyn PublisherChanges>;

    /// Changes the bounds of messages that are received from now on.
    fn set_message_limits(&self, max_message_bytes: usize, memory: Option<Arc<dyn MemoryLimit>>);
}

/// A view of the publishers of a topic.
pub(super) trait PublisherChanges: Send + Sync {
    /// Returns a future that ends when the publishers have changed since the view was made.
    fn changed(&self) -> BoxFuture<'_, ()>;
}

/// Ends the node of a connection or cloud that has failed, in the background.
pub(super) fn end_in_background(node: Arc<dyn SessionNode>, patience: Duration) {
    match tokio::runtime::Handle::try_current() {
        Ok(runtime) => {
            runtime.spawn(async move { node.end(patience).await });
        }
        Err(_) => node.close(),
    }
}
