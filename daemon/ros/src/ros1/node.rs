//! A node of ROS 1.

use std::sync::Arc;

use peernet_clock::SharedClock;

use super::acceptor;
use super::address::{NodeAddress, advertised_host};
use super::environment::{Environment, RpcUri};
use super::error::NodeError;
use super::lifetime::NodeLifetime;
use super::master::{MasterClient, SystemState};
use super::names::NodeName;
use super::node_topics::NodeTopics;
use super::publisher::{PublishedTopic, Publisher, PublisherOptions};
use super::registrar::Registrar;
use super::registration::{Registration, Role};
use super::registration_guard::RegistrationGuard;
use super::rpc;
use super::slave;
use super::subscriber::{SubscribedTopic, Subscriber, SubscriberOptions};
use super::tcpros::{Publication, Subscription, TopicType};

/// A node of ROS 1. Its publishers and subscribers end with it. [`Node::shutdown`] removes its registrations; a node
/// that is only dropped stays in the master's lists.
#[derive(Debug)]
pub struct Node {
    state: Arc<NodeState>,
}

impl Node {
    /// Creates a node: opens its ports and checks that the master answers. `name` has no namespace, such as `camera`.
    ///
    /// # Errors
    /// If the name is not allowed, no port can be opened, or the master does not answer.
    pub async fn new(environment: &Environment, name: &str, clock: SharedClock) -> Result<Self, NodeError> {
        let name = NodeName::new(&environment.namespace, name)?;
        let master = MasterClient::new(environment.master.clone(), name.global());
        master.check().await?;
        let host = match &environment.advertised_host {
            Some(host) => host.clone(),
            None => advertised_host(&environment.master).await,
        };
        let (address, listeners) = NodeAddress::listen(host).await?;
        let (topics, lifetime) =
            (Arc::new(NodeTopics::default()), Arc::new(NodeLifetime::new(name.to_arc())));
        let registrar = Registrar::new(master, address.uri(), Arc::clone(&topics), Arc::clone(&lifetime));
        let registrar = Arc::new(registrar);
        let state = Arc::new(NodeState { name, clock, address, topics, registrar, lifetime });
        let (node, tasks) = (Arc::clone(&state), state.lifetime.tasks());
        let answer = move |call: &_| slave::answer(&node, call);
        tasks.spawn(rpc::serve(listeners.rpc, answer, state.lifetime.stop().clone()));
        tasks.spawn(acceptor::accept_connections(Arc::clone(&state), listeners.tcpros));
        let registrar = Arc::clone(&state.registrar);
        tasks.spawn(async move { registrar.run().await });
        Ok(Self { state })
    }

    /// Returns the global name of the node.
    pub fn name(&self) -> &str {
        self.state.name.global()
    }

    /// Returns the URI of the node's XML-RPC server.
    pub fn uri(&self) -> &str {
        self.state.address.uri()
    }

    /// Returns the global name of a topic.
    ///
    /// # Errors
    /// If the name is not allowed.
    pub fn resolve(&self, topic: &str) -> Result<String, NodeError> {
        Ok(self.state.name.resolve(topic)?)
    }

    /// Publishes a topic.
    ///
    /// # Errors
    /// If the name is not allowed, the type is `*`, the node already publishes the topic, or the registration fails.
    pub async fn publish(
        &self,
        topic: &str,
        kind: TopicType,
        options: PublisherOptions,
    ) -> Result<Publisher, NodeError> {
        let state = &self.state;
        let topic: Arc<str> = state.name.resolve(topic)?.into();
        state.lifetime.check_open()?;
        if kind.is_any() {
            return Err(NodeError::PublishedWildcard { topic: topic.to_string() });
        }
        let registration =
            Registration { role: Role::Publisher, topic: Arc::clone(&topic), kind: Arc::clone(&kind.name) };
        let (node, is_latching) = (state.name.to_arc(), options.is_latching);
        let publication = Publication { node, topic, kind, is_latching };
        let stop = state.lifetime.stop().child_token();
        let published = Arc::new(PublishedTopic::new(publication, options.queue, stop));
        // The topic is added before the registration, because the master informs subscribers at once.
        state.topics.add_published(Arc::clone(&published))?;
        let (guard, _) = RegistrationGuard::register(&state.registrar, registration).await?;
        Ok(Publisher { topic: published, guard })
    }

    /// Subscribes to a topic. Publishers may come and go at any time.
    ///
    /// # Errors
    /// If the name is not allowed, the node already subscribes to the topic, or the registration fails.
    pub async fn subscribe(
        &self,
        topic: &str,
        kind: TopicType,
        options: SubscriberOptions,
    ) -> Result<Subscriber, NodeError> {
        let state = &self.state;
        let topic: Arc<str> = state.name.resolve(topic)?.into();
        state.lifetime.check_open()?;
        let registration =
            Registration { role: Role::Subscriber, topic: Arc::clone(&topic), kind: Arc::clone(&kind.name) };
        let subscription = Subscription { node: state.name.to_arc(), topic, kind };
        let (clock, lifetime) = (Arc::clone(&state.clock), &state.lifetime);
        let subscribed = Arc::new(SubscribedTopic::new(subscription, options, clock, lifetime));
        // The topic is added before the registration, because the master may report new publishers at once.
        state.topics.add_subscribed(Arc::clone(&subscribed))?;
        let (guard, publishers) = RegistrationGuard::register(&state.registrar, registration).await?;
        subscribed.add_publishers(&publishers);
        Ok(Subscriber { topic: subscribed, guard })
    }

    /// Returns all topics and services that the master knows, with their nodes.
    ///
    /// # Errors
    /// If the master does not answer.
    pub async fn system_state(&self) -> Result<SystemState, NodeError> {
        self.state.registrar.master().system_state().await
    }

    /// Returns all topics that the master knows, with the names of their types.
    ///
    /// # Errors
    /// If the master does not answer.
    pub async fn topic_types(&self) -> Result<Vec<(String, String)>, NodeError> {
        self.state.registrar.master().topic_types().await
    }

    /// Returns the nodes among `nodes` that are running and publish a topic, except this node. The master also lists
    /// nodes that ended without unregistering. Another node with this node's name is included until this node has
    /// registered a topic; from then on the master knows only this node by the name.
    ///
    /// # Errors
    /// If the master does not answer.
    pub async fn running_publishers(&self, topic: &str, nodes: &[String]) -> Result<Vec<String>, NodeError> {
        self.running_nodes("getPublications", topic, nodes).await
    }

    /// Returns the nodes among `nodes` that are running and subscribe to a topic, except this node, as
    /// [`Node::running_publishers`] does.
    ///
    /// # Errors
    /// If the master does not answer.
    pub async fn running_subscribers(&self, topic: &str, nodes: &[String]) -> Result<Vec<String>, NodeError> {
        self.running_nodes("getSubscriptions", topic, nodes).await
    }

    async fn running_nodes(
        &self,
        method: &str,
        topic: &str,
        nodes: &[String],
    ) -> Result<Vec<String>, NodeError> {
        let mut running = Vec::new();
        for node in nodes {
            let uri = self.state.registrar.master().look_up_node(node).await?.filter(|uri| uri != self.uri());
            let Some(uri) = uri.and_then(|uri| RpcUri::parse(&uri).ok()) else { continue };
            // An answer alone proves nothing: the port of a node that ended may belong to another node now.
            let answer = rpc::call(&uri, method, vec![self.name().into()]).await;
            if answer.is_ok_and(|answer| slave::has_topic(answer, topic)) {
                running.push(node.clone());
            }
        }
        Ok(running)
    }

    /// Waits until the node has ended. Returns the reason, such as that another node has taken its name, or that it was
    /// asked to shut down (`rosnode kill`).
    pub async fn ended(&self) -> NodeError {
        self.state.lifetime.stop().cancelled().await;
        self.state.lifetime.closed_error()
    }

    /// Ends the node at once. Its registrations stay with the master.
    pub fn close(&self) {
        self.state.lifetime.end("it was closed".to_owned());
    }

    /// Ends the node. Waiting messages are written within a second, and all topics are unregistered.
    ///
    /// # Errors
    /// If the topics could not be unregistered. The master then lists the node until `rosnode cleanup` removes it.
    pub async fn shutdown(&self) -> Result<(), NodeError> {
        let lifetime = &self.state.lifetime;
        lifetime.end("it was shut down".to_owned());
        lifetime.wait_for_tasks().await;
        // The tasks end first, because subscribers may disconnect from a publisher that is no longer registered.
        self.state.registrar.unregister_all().await
    }
}

#[cfg(test)]
impl Node {
    pub(super) fn state(&self) -> &NodeState {
        &self.state
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        self.state.lifetime.end("it was dropped".to_owned());
    }
}

/// State that the tasks of a node share.
#[derive(Debug)]
pub(super) struct NodeState {
    pub(super) name: NodeName,
    pub(super) clock: SharedClock,
    pub(super) address: NodeAddress,
    pub(super) topics: Arc<NodeTopics>,
    pub(super) registrar: Arc<Registrar>,
    pub(super) lifetime: Arc<NodeLifetime>,
}
