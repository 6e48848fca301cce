//! Nodes of ROS 1 for sessions.

use std::sync::Arc;
use std::time::Duration;

use futures::FutureExt;
use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use peernet_ros::messages::{EncodedMessage, Message, MessageInfo, WireForm};
use peernet_ros::ros1::{
    Delivery, Environment, EnvironmentError, MemoryLimit, Node, NodeError, Publisher, PublisherInfo,
    PublisherOptions, PublisherState, PublisherWatch, QueueLimits, ReceivedMessage, RpcUri, Subscriber,
    SubscriberOptions, TopicType,
};
use tokio::time::timeout;

use super::interface::{
    EdgeTopics, NodeFailure, PublisherChanges, RemoteNode, SessionNode, SessionPublisher, SessionSubscriber,
    TopicMessage, TopicPurpose,
};
use super::names::{base_name, cloud_node, sessions_topic};
use crate::Address;

/// A node, and the master that it is registered with.
#[derive(Debug)]
pub(super) struct Ros1Node {
    node: Node,
    /// Host and port of the master.
    master: String,
}

impl Ros1Node {
    /// Registers a node with the address's master.
    pub(super) async fn open(
        address: &Address,
        name: &str,
        clock: &SharedClock,
    ) -> Result<Self, NodeFailure> {
        let node = Node::new(&environment(address)?, name, SharedClock::clone(clock)).await?;
        Ok(Self { node, master: address.authority() })
    }

    /// Returns the name of the cloud's node. Checks that no other program publishes the topics of requests, and that
    /// the topics have the expected types.
    async fn find_cloud_and_check_topics(&self, topics: &EdgeTopics) -> Result<Arc<str>, NodeFailure> {
        let state = self.node.system_state().await?;
        let sessions = sessions_topic(&topics.cloud);
        let is_cloud = |node: &&String| base_name(node) == cloud_node(&topics.cloud);
        let clouds: Vec<String> = state.subscribers_of(&sessions).iter().filter(is_cloud).cloned().collect();
        // The master keeps registrations of nodes that were killed, so each node is asked whether it runs.
        let mut clouds = self.node.running_subscribers(&sessions, &clouds).await?;
        let Some(cloud) = clouds.pop() else {
            return Err(NodeFailure(format!(
                "the ROS master at {} knows no cloud with the name {}: no node subscribes to {sessions}; start the cloud with \
                 this master and name",
                self.master, topics.cloud
            )));
        };
        // Earlier nodes of this pipeline may still be registered. They do not count as other programs.
        let is_of_other_program = |node: &&String| !base_name(node).starts_with(&topics.node_name_prefix);
        for topic in [&topics.request.info, &topics.request.payload] {
            let other_publishers: Vec<String> =
                state.publishers_of(topic).iter().filter(is_of_other_program).cloned().collect();
            if let Some(publisher) = self.node.running_publishers(topic, &other_publishers).await?.first() {
                return Err(NodeFailure(format!(
                    "node {publisher} publishes topic {topic} already; stop it, give the pipeline another name, or set \
                     ROS_NAMESPACE to a namespace of this robot"
                )));
            }
        }
        let types = self.node.topic_types().await?;
        let expected = MessageInfo::DEFINITION.name;
        for topic in [&topics.request.info, &topics.response.info] {
            // The master keeps the type of a topic that nobody uses any more. `*` is any type.
            let is_used = !state.publishers_of(topic).is_empty() || !state.subscribers_of(topic).is_empty();
            let other_type =
                types.iter().find(|(name, kind)| name == topic && kind != expected && kind != "*");
            if let Some((_, kind)) = other_type.filter(|_| is_used) {
                return Err(NodeFailure(format!(
                    "topic {topic} has the message type {kind} and would need {expected}; give the pipeline another name, \
                     or set ROS_NAMESPACE to a namespace of this robot"
                )));
            }
        }
        Ok(cloud.into())
    }

    /// Returns another running node that is a cloud with the name `cloud`: a subscriber of its sessions topic with this
    /// node's base name, in another namespace. Programs that only observe the topic have other base names. A node with
    /// the same full name as this node is not found, because the master replaced it by this node.
    async fn find_other_cloud(&self, cloud: &str) -> Result<Option<String>, NodeError> {
        let state = self.node.system_state().await?;
        let own_base_name = base_name(self.node.name());
        let is_cloud = |node: &&String| base_name(node) == own_base_name;
        let sessions = sessions_topic(cloud);
        let clouds: Vec<String> = state.subscribers_of(&sessions).iter().filter(is_cloud).cloned().collect();
        Ok(self.node.running_subscribers(&sessions, &clouds).await?.pop())
    }
}

impl SessionNode for Ros1Node {
    fn form(&self) -> WireForm {
        WireForm::Ros1
    }

    fn name(&self) -> &str {
        self.node.name()
    }

    fn describe(&self, node: &str) -> String {
        format!("node {node}")
    }

    fn resolve(&self, name: &str) -> Result<String, NodeFailure> {
        Ok(self.node.resolve(name)?)
    }

    fn find_cloud_and_check_topics<'a>(
        &'a self,
        topics: &'a EdgeTopics,
    ) -> BoxFuture<'a, Result<Arc<str>, NodeFailure>> {
        Self::find_cloud_and_check_topics(self, topics).boxed()
    }

    fn check_cloud_name<'a>(&'a self, cloud: &'a str) -> BoxFuture<'a, Result<(), NodeFailure>> {
        let check = async move {
            match self.find_other_cloud(cloud).await? {
                None => Ok(()),
                Some(other_cloud) => Err(NodeFailure(format!(
                    "node {other_cloud} is already a cloud with the name {cloud} at this ROS master; stop it, or end the \
                     address with another name"
                ))),
            }
        };
        check.boxed()
    }

    fn receive_buffer_bytes(&self) -> Option<usize> {
        None
    }

    fn max_companion_bytes(&self) -> usize {
        usize::MAX
    }

    fn payload_timeout(&self) -> Option<Duration> {
        None
    }

    fn caveat(&self) -> Option<&str> {
        None
    }

    fn publish<'a>(
        &'a self,
        topic: &'a str,
        (_, kind): (TopicPurpose, TopicType),
        queue: QueueLimits,
    ) -> BoxFuture<'a, Result<Box<dyn SessionPublisher>, NodeFailure>> {
        let publish = async move {
            let options = PublisherOptions { is_latching: false, queue };
            let publisher = self.node.publish(topic, kind, options).await?;
            Ok(Box::new(publisher) as Box<dyn SessionPublisher>)
        };
        publish.boxed()
    }

    fn subscribe<'a>(
        &'a self,
        topic: &'a str,
        (_, kind): (TopicPurpose, TopicType),
        options: SubscriberOptions,
    ) -> BoxFuture<'a, Result<Box<dyn SessionSubscriber>, NodeFailure>> {
        let subscribe = async move {
            let subscriber = self.node.subscribe(topic, kind, options).await?;
            Ok(Box::new(subscriber) as Box<dyn SessionSubscriber>)
        };
        subscribe.boxed()
    }

    // Best effort: the registrations stay if the master does not answer in time.
    fn end(&self, time_limit: Duration) -> BoxFuture<'_, ()> {
        let end = async move {
            match timeout(time_limit, self.node.shutdown()).await {
                Ok(Ok(())) => {}
                Ok(Err(error)) => {
                    tracing::debug!(%error, node = self.name(), "cannot unregister a node from the ROS master");
                }
                Err(_) => {
                    tracing::debug!(node = self.name(), "the ROS master did not unregister a node in time");
                }
            }
        };
        end.boxed()
    }

    fn close(&self) {
        self.node.close();
    }
}

// A call such as `Self::topic(self)` calls the type's own method, which has the same name as the method of the trait.
impl SessionPublisher for Publisher {
    fn topic(&self) -> &str {
        Self::topic(self)
    }

    fn publish(&self, message: EncodedMessage) -> Result<(), NodeFailure> {
        Self::publish(self, message)?;
        Ok(())
    }

    fn publish_fragments(&self, node: &str, fragments: &[EncodedMessage]) -> Result<Delivery, NodeFailure> {
        for fragment in fragments {
            let delivery = Self::publish_to(self, node, fragment.clone())?;
            // A message is useless if one of its fragments is missing, so the other fragments are not published.
            if delivery != Delivery::Accepted {
                return Ok(delivery);
            }
        }
        Ok(Delivery::Accepted)
    }

    fn is_full(&self, node: &str, length: usize) -> bool {
        self.is_full_for(node, length)
    }

    // There is never a mismatch here: the master and the headers of connections detect such problems earlier.
    fn describe_mismatch(&self, _node: &str) -> Option<String> {
        None
    }
}

// Calls such as `Self::topic(self)` call the type's own methods here, too.
impl SessionSubscriber for Subscriber {
    fn topic(&self) -> &str {
        Self::topic(self)
    }

    fn recv(&mut self) -> BoxFuture<'_, Result<TopicMessage, NodeFailure>> {
        async move { Ok(TopicMessage::from(Self::recv(self).await?)) }.boxed()
    }

    fn try_recv(&mut self) -> Option<TopicMessage> {
        Self::try_recv(self).map(TopicMessage::from)
    }

    fn is_connected(&self, node: &str) -> bool {
        let is_node =
            |state: &PublisherState| matches!(state, PublisherState::Connected(info) if *info.node == *node);
        self.publishers().iter().any(|publisher| is_node(&publisher.state))
    }

    fn rejected_publishers(&self) -> Vec<Arc<str>> {
        self.publishers().into_iter().filter_map(|publisher| publisher.rejected_node).collect()
    }

    fn watch(&self) -> Box<dyn PublisherChanges> {
        Box::new(self.publisher_watch())
    }

    fn set_message_limits(&self, max_message_bytes: usize, memory: Option<Arc<dyn MemoryLimit>>) {
        Self::set_message_limits(self, max_message_bytes, memory);
    }
}

impl PublisherChanges for PublisherWatch {
    // The inner future is created at once, because it reports the changes since its creation.
    fn changed(&self) -> BoxFuture<'_, ()> {
        Self::changed(self).boxed()
    }
}

impl From<ReceivedMessage> for TopicMessage {
    fn from(message: ReceivedMessage) -> Self {
        let type_name = Arc::clone(&message.publisher.kind.name);
        let publisher = RemoteNode::from(&*message.publisher);
        Self { bytes: message.bytes, publisher, type_name, memory: message.memory }
    }
}

impl From<&PublisherInfo> for RemoteNode {
    fn from(info: &PublisherInfo) -> Self {
        Self { node: Arc::clone(&info.node), local: info.local, remote: info.remote }
    }
}

/// Returns the settings of ROS: the master from the address, all else from environment variables.
fn environment(address: &Address) -> Result<Environment, EnvironmentError> {
    let master = RpcUri::parse(&format!("http://{}", address.authority()))?;
    Ok(Environment { master, ..Environment::from_process()? })
}
