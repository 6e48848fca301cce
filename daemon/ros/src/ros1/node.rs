//! A node: what the master knows by one name.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use peernet_clock::{LogThrottle, SharedClock};
use tokio::net::TcpListener;
use tokio::sync::Notify;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::acceptor;
use super::address::advertised_host;
use super::environment::{Environment, RpcUri, listen_address, uri_host};
use super::error::NodeError;
use super::master::{MasterClient, SystemState};
use super::names::NodeName;
use super::publisher::{PublishedTopic, Publisher, PublisherOptions};
use super::registrar::{self, method_of};
use super::registration::{Registration, Registrations, Role};
use super::rpc::{self, CALL_TIMEOUT};
use super::slave;
use super::subscriber::{SubscribedTopic, Subscriber, SubscriberOptions};
use super::tcpros::{Publication, Subscription, TopicType};

/// A node of ROS 1. Publishers and subscribers end with it. [`Node::shutdown`] removes its registrations; a node that is only
/// dropped stays in the master's lists.
#[derive(Debug)]
pub struct Node {
    shared: Arc<NodeShared>,
}

impl Node {
    /// Opens the ports of a node with a name without namespace, such as `camera`, and checks that the master answers.
    ///
    /// # Errors
    /// The name is not allowed, no port can be opened, or the master does not answer.
    pub async fn new(environment: &Environment, name: &str, clock: SharedClock) -> Result<Self, NodeError> {
        let name = NodeName::new(&environment.namespace, name)?;
        let master = MasterClient::new(environment.master.clone(), name.full());
        master.check().await?;
        let host = match &environment.advertised_host {
            Some(host) => host.clone(),
            None => advertised_host(&environment.master).await,
        };
        let rpc_listener = listen(&host).await?;
        let tcpros_listener = listen(&host).await?;
        let uri = format!("http://{}:{}/", uri_host(&host), port(&rpc_listener)?);
        let shared = Arc::new(NodeShared {
            name: name.full().into(),
            tcpros_port: port(&tcpros_listener)?,
            names: name,
            clock,
            uri,
            host,
            master,
            topics: Mutex::default(),
            registrations: Mutex::default(),
            log_throttle: Mutex::default(),
            wake_registrar: Notify::new(),
            stop: CancellationToken::new(),
            end_reason: OnceLock::new(),
            tasks: TaskTracker::new(),
        });
        let (node, stop) = (Arc::clone(&shared), shared.stop.clone());
        let answer = move |call: &_| slave::answer(&node, call);
        shared.tasks.spawn(rpc::serve(rpc_listener, answer, stop));
        shared.tasks.spawn(acceptor::run(Arc::clone(&shared), tcpros_listener));
        shared.tasks.spawn(registrar::run(Arc::clone(&shared)));
        Ok(Self { shared })
    }

    /// Returns the global name of the node.
    pub fn name(&self) -> &str {
        &self.shared.name
    }

    /// Returns the URI of the node's XML-RPC server.
    pub fn uri(&self) -> &str {
        &self.shared.uri
    }

    /// Returns the global name of a topic.
    ///
    /// # Errors
    /// The name is not allowed.
    pub fn resolve(&self, topic: &str) -> Result<String, NodeError> {
        Ok(self.shared.names.resolve(topic)?)
    }

    /// Publishes a topic.
    ///
    /// # Errors
    /// The name is not allowed, the type is `*`, the node publishes the topic already, or the registration fails.
    pub async fn publish(
        &self,
        topic: &str,
        kind: TopicType,
        options: PublisherOptions,
    ) -> Result<Publisher, NodeError> {
        let shared = &self.shared;
        let topic: Arc<str> = shared.names.resolve(topic)?.into();
        shared.check_open()?;
        if kind.is_any() {
            return Err(NodeError::PublishedWildcard { topic: topic.to_string() });
        }
        let registration =
            Registration { role: Role::Publisher, topic: Arc::clone(&topic), kind: Arc::clone(&kind.name) };
        let publication = Publication {
            node: Arc::clone(&shared.name),
            topic: Arc::clone(&topic),
            kind,
            is_latching: options.is_latching,
        };
        let published = Arc::new(PublishedTopic::new(publication, options.queue, shared.stop.child_token()));
        {
            let mut topics = shared.topics();
            if topics.publications.contains_key(&topic) {
                return Err(NodeError::AlreadyPublished { topic: topic.to_string() });
            }
            // Before the master knows: it tells subscribers at once.
            topics.publications.insert(topic, Arc::clone(&published));
        }
        let guard = RegistrationGuard { shared: Arc::clone(shared), registration };
        guard.register().await?;
        Ok(Publisher { topic: published, guard })
    }

    /// Subscribes to a topic. Publishers may come and go at any time.
    ///
    /// # Errors
    /// The name is not allowed, the node subscribes to the topic already, or the registration fails.
    pub async fn subscribe(
        &self,
        topic: &str,
        kind: TopicType,
        options: SubscriberOptions,
    ) -> Result<Subscriber, NodeError> {
        let shared = &self.shared;
        let topic: Arc<str> = shared.names.resolve(topic)?.into();
        shared.check_open()?;
        let registration =
            Registration { role: Role::Subscriber, topic: Arc::clone(&topic), kind: Arc::clone(&kind.name) };
        let subscription = Subscription { node: Arc::clone(&shared.name), topic: Arc::clone(&topic), kind };
        let subscribed = Arc::new(SubscribedTopic::new(
            subscription,
            options,
            Arc::clone(&shared.clock),
            shared.stop.child_token(),
            shared.tasks.clone(),
        ));
        {
            let mut topics = shared.topics();
            if topics.subscriptions.contains_key(&topic) {
                return Err(NodeError::AlreadySubscribed { topic: topic.to_string() });
            }
            topics.subscriptions.insert(topic, Arc::clone(&subscribed));
        }
        let guard = RegistrationGuard { shared: Arc::clone(shared), registration };
        subscribed.add_publishers(&guard.register().await?);
        Ok(Subscriber { topic: subscribed, guard })
    }

    /// Asks the master for all topics and services with their nodes.
    ///
    /// # Errors
    /// The master does not answer.
    pub async fn system_state(&self) -> Result<SystemState, NodeError> {
        self.shared.master.system_state().await
    }

    /// Asks the master for all topics with the names of their types.
    ///
    /// # Errors
    /// The master does not answer.
    pub async fn topic_types(&self) -> Result<Vec<(String, String)>, NodeError> {
        self.shared.master.topic_types().await
    }

    /// Returns those of some nodes, without this one, that are running and publish a topic. The master also lists nodes that
    /// ended without telling it. One of this node's name counts until this node has registered something.
    ///
    /// # Errors
    /// The master does not answer.
    pub async fn running_publishers(&self, topic: &str, nodes: &[String]) -> Result<Vec<String>, NodeError> {
        self.running_nodes("getPublications", topic, nodes).await
    }

    /// Returns those of some nodes, without this one, that are running and subscribe to a topic, as
    /// [`Node::running_publishers`] does.
    ///
    /// # Errors
    /// The master does not answer.
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
            let uri = self.shared.master.look_up_node(node).await?.filter(|uri| *uri != self.shared.uri);
            let Some(uri) = uri.and_then(|uri| RpcUri::parse(&uri).ok()) else { continue };
            // An answer alone is no proof: the port of a node that ended may belong to another one by now.
            let answer = rpc::call(&uri, method, vec![self.name().into()]).await;
            if answer.is_ok_and(|answer| slave::has_topic(answer, topic)) {
                running.push(node.clone());
            }
        }
        Ok(running)
    }

    /// Waits until the node has ended by itself, and returns the reason: another node has taken its name, or somebody
    /// asked it to shut down (`rosnode kill`).
    pub async fn ended(&self) -> NodeError {
        self.shared.stop.cancelled().await;
        self.shared.closed()
    }

    /// Ends the node at once, without telling the master.
    pub fn close(&self) {
        self.shared.close("it was closed".to_owned());
    }

    /// Ends the node: messages that wait for subscribers are written within a second, and all topics are
    /// unregistered.
    ///
    /// # Errors
    /// The topics could not be unregistered; the master lists the node until `rosnode cleanup` removes it.
    pub async fn shutdown(&self) -> Result<(), NodeError> {
        let shared = &self.shared;
        shared.close("it was shut down".to_owned());
        shared.tasks.close();
        shared.tasks.wait().await;
        let registrations = shared.registrations().take_all();
        let unregister = async {
            for registration in registrations {
                let method = method_of(registration.role).1;
                shared.master.unregister(method, &registration.topic, &shared.uri).await?;
            }
            Ok(())
        };
        let late = |_| {
            let (uri, source) = (shared.master.uri().to_string(), rpc::RpcError::TimedOut);
            Err(NodeError::NoMaster { uri, source })
        };
        timeout(CALL_TIMEOUT, unregister).await.unwrap_or_else(late)
    }
}

#[cfg(test)]
impl Node {
    pub(super) fn shared(&self) -> &NodeShared {
        &self.shared
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        self.shared.close("it was dropped".to_owned());
    }
}

async fn listen(host: &str) -> Result<TcpListener, NodeError> {
    let address = SocketAddr::new(listen_address(host), 0);
    TcpListener::bind(address).await.map_err(|source| NodeError::Listen { address, source })
}

fn port(listener: &TcpListener) -> Result<u16, NodeError> {
    let address = SocketAddr::from(([0; 4], 0));
    let own = listener.local_addr().map_err(|source| NodeError::Listen { address, source })?;
    Ok(own.port())
}

/// The state that the tasks of a node share.
#[derive(Debug)]
pub(super) struct NodeShared {
    pub(super) name: Arc<str>,
    names: NodeName,
    pub(super) clock: SharedClock,
    /// URI of the own XML-RPC server.
    pub(super) uri: String,
    /// Host name or address that other nodes connect to.
    pub(super) host: String,
    pub(super) tcpros_port: u16,
    pub(super) master: MasterClient,
    topics: Mutex<Topics>,
    registrations: Mutex<Registrations>,
    log_throttle: Mutex<LogThrottle>,
    pub(super) wake_registrar: Notify,
    pub(super) stop: CancellationToken,
    end_reason: OnceLock<String>,
    pub(super) tasks: TaskTracker,
}

/// Topics of a node by their global names.
#[derive(Debug, Default)]
pub(super) struct Topics {
    pub(super) publications: BTreeMap<Arc<str>, Arc<PublishedTopic>>,
    pub(super) subscriptions: BTreeMap<Arc<str>, Arc<SubscribedTopic>>,
}

impl Topics {
    /// Returns what is published and what is subscribed to.
    pub(super) fn lists(&self) -> (Vec<Arc<PublishedTopic>>, Vec<Arc<SubscribedTopic>>) {
        (self.publications.values().cloned().collect(), self.subscriptions.values().cloned().collect())
    }
}

impl NodeShared {
    pub(super) fn log_throttle(&self) -> MutexGuard<'_, LogThrottle> {
        self.log_throttle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn topics(&self) -> MutexGuard<'_, Topics> {
        self.topics.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn registrations(&self) -> MutexGuard<'_, Registrations> {
        self.registrations.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the node; the first reason counts.
    pub(super) fn close(&self, reason: String) {
        // An error says that there is a reason already.
        let _ = self.end_reason.set(reason);
        self.stop.cancel();
    }

    fn check_open(&self) -> Result<(), NodeError> {
        if self.stop.is_cancelled() { Err(self.closed()) } else { Ok(()) }
    }

    fn closed(&self) -> NodeError {
        let reason = self.end_reason.get().cloned().unwrap_or_else(|| "it was shut down".to_owned());
        NodeError::Closed { node: self.name.to_string(), reason }
    }
}

/// Keeps a topic in the node and with the master until it is dropped.
#[derive(Debug)]
pub(super) struct RegistrationGuard {
    shared: Arc<NodeShared>,
    registration: Registration,
}

impl RegistrationGuard {
    /// Tells the master, and returns the URIs of the topic's publishers or subscribers.
    async fn register(&self) -> Result<Vec<String>, NodeError> {
        let Registration { role, topic, kind } = &self.registration;
        // A master that was restarted knows the node again once this topic is registered: the loss of the others would not show.
        registrar::check(&self.shared).await;
        let (register, _) = method_of(*role);
        let uris = self.shared.master.register(register, topic, kind, &self.shared.uri).await?;
        self.shared.registrations().add(self.registration.clone());
        Ok(uris)
    }

    /// Checks that the node has not ended.
    ///
    /// # Errors
    /// It has.
    pub(super) fn check_open(&self) -> Result<(), NodeError> {
        self.shared.check_open()
    }

    /// Returns the error of a node that has ended.
    pub(super) fn closed(&self) -> NodeError {
        self.shared.closed()
    }
}

impl Drop for RegistrationGuard {
    fn drop(&mut self) {
        {
            let mut topics = self.shared.topics();
            let topic = &self.registration.topic;
            match self.registration.role {
                Role::Publisher => topics.publications.remove(topic).map(|topic| topic.stop.cancel()),
                Role::Subscriber => topics.subscriptions.remove(topic).map(|topic| topic.stop.cancel()),
            };
        }
        // Also where the registration failed: the master may know it all the same.
        self.shared.registrations().remove(self.registration.clone());
        self.shared.wake_registrar.notify_one();
    }
}
