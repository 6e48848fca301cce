//! Keeps the registrations of a node's topics with the master up to date.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;
use tokio::time::{sleep, timeout};

use super::environment::RpcUri;
use super::error::NodeError;
use super::lifetime::NodeLifetime;
use super::master::MasterClient;
use super::node_topics::NodeTopics;
use super::registration::{CallOutcome, MasterCall, Notice, Registration, Registrations, Role};
use super::rpc::{self, CALL_TIMEOUT, RpcError};

/// Returns the methods of the master's API that add and remove a registration.
fn registration_methods(role: Role) -> (&'static str, &'static str) {
    match role {
        Role::Publisher => ("registerPublisher", "unregisterPublisher"),
        Role::Subscriber => ("registerSubscriber", "unregisterSubscriber"),
    }
}

/// Registrations of a node with the master. Every change wakes the task that calls the master.
#[derive(Debug)]
pub(super) struct Registrar {
    master: MasterClient,
    /// URI of the node's XML-RPC server.
    uri: String,
    topics: Arc<NodeTopics>,
    lifetime: Arc<NodeLifetime>,
    registrations: Mutex<Registrations>,
    /// Notified when a call may be due.
    wake: Notify,
}

impl Registrar {
    pub(super) fn new(
        master: MasterClient,
        uri: &str,
        topics: Arc<NodeTopics>,
        lifetime: Arc<NodeLifetime>,
    ) -> Self {
        let (registrations, wake) = (Mutex::default(), Notify::new());
        Self { master, uri: uri.to_owned(), topics, lifetime, registrations, wake }
    }

    /// Returns the client of the master.
    pub(super) fn master(&self) -> &MasterClient {
        &self.master
    }

    /// Returns the lifetime of the node.
    pub(super) fn lifetime(&self) -> &NodeLifetime {
        &self.lifetime
    }

    fn registrations(&self) -> MutexGuard<'_, Registrations> {
        self.registrations.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Registers a topic. Returns the URIs of the topic's subscribers for a publisher, of its publishers for a
    /// subscriber.
    ///
    /// # Errors
    /// If the master does not answer or refuses.
    pub(super) async fn register(&self, registration: &Registration) -> Result<Vec<String>, NodeError> {
        // Once this topic is registered, a restarted master knows the node again, and the loss of the other topics can
        // no longer be detected. They are therefore checked first.
        self.check_registered().await;
        let uris = self.call_register(registration).await?;
        self.registrations().add(registration.clone());
        Ok(uris)
    }

    /// Removes a topic from the node, and unregisters the topic in the background.
    pub(super) fn remove(&self, registration: Registration) {
        self.topics.remove(registration.role, &registration.topic);
        // The topic is unregistered even if its registration failed, because the master may know the topic
        // nevertheless.
        self.registrations().remove(registration);
        self.wake.notify_one();
    }

    /// Unregisters all topics of a node that has ended.
    ///
    /// # Errors
    /// If the master does not answer in time or refuses.
    pub(super) async fn unregister_all(&self) -> Result<(), NodeError> {
        let registrations = self.registrations().take_all();
        let unregister = async {
            for registration in registrations {
                self.call_unregister(&registration).await?;
            }
            Ok(())
        };
        let timed_out = |_| {
            let (uri, source) = (self.master.uri().to_string(), RpcError::TimedOut);
            Err(NodeError::NoMaster { uri, source })
        };
        timeout(CALL_TIMEOUT, unregister).await.unwrap_or_else(timed_out)
    }

    /// Makes the task ask the master which node has this node's name.
    pub(super) fn request_check(&self) {
        self.registrations().request_check();
        self.wake.notify_one();
    }

    /// Makes the calls of the master that are due, until the node ends.
    pub(super) async fn run(&self) {
        loop {
            let (call, interval) = {
                let registrations = self.registrations();
                (registrations.next_call(), registrations.wait_interval())
            };
            if let Some(call) = call {
                let outcome = tokio::select! {
                    outcome = self.call_master(&call) => outcome,
                    () = self.lifetime.stop().cancelled() => return,
                };
                self.handle_outcome(&call, outcome);
                continue;
            }
            tokio::select! {
                () = sleep(interval) => self.registrations().request_check(),
                () = self.wake.notified() => {}
                () = self.lifetime.stop().cancelled() => return,
            }
        }
    }

    /// Asks the master whether it still knows the node. If not, all topics are due for registration.
    async fn check_registered(&self) {
        if !self.registrations().has_registered() {
            return;
        }
        let call = MasterCall::LookUpNode;
        let outcome = self.call_master(&call).await;
        self.handle_outcome(&call, outcome);
        self.wake.notify_one();
    }

    /// Makes a call of the master, and classifies the outcome.
    async fn call_master(&self, call: &MasterCall) -> CallOutcome {
        let result = match call {
            MasterCall::LookUpNode => match self.master.look_up_node(self.lifetime.node()).await {
                Ok(None) => return CallOutcome::NodeUnknown,
                Ok(Some(uri)) if uri != self.uri => {
                    // If the node at `uri` has ended, it has not replaced this node: the registration of the ended node
                    // reached the master late.
                    let is_running = self.is_running(&uri).await;
                    return if is_running {
                        CallOutcome::NodeReplaced { uri }
                    } else {
                        CallOutcome::NodeUnknown
                    };
                }
                Ok(Some(_)) => Ok(()),
                Err(error) => Err(error),
            },
            MasterCall::Register(registration) => self.reregister(registration).await,
            MasterCall::Unregister(registration) => self.call_unregister(registration).await,
        };
        match result {
            Ok(()) => CallOutcome::Success,
            Err(error @ NodeError::MasterRefused { .. }) => {
                CallOutcome::Refused { reason: error.to_string() }
            }
            Err(error) => CallOutcome::Unreachable { reason: error.to_string() },
        }
    }

    async fn call_register(&self, registration: &Registration) -> Result<Vec<String>, NodeError> {
        let Registration { role, topic, kind } = registration;
        self.master.register(registration_methods(*role).0, topic, kind, &self.uri).await
    }

    async fn call_unregister(&self, registration: &Registration) -> Result<(), NodeError> {
        let method = registration_methods(registration.role).1;
        self.master.unregister(method, &registration.topic, &self.uri).await
    }

    /// Registers a topic that the master does not know any more.
    async fn reregister(&self, registration: &Registration) -> Result<(), NodeError> {
        let uris = self.call_register(registration).await?;
        // For a publisher the answer lists subscribers, which connect by themselves.
        if registration.role == Role::Subscriber
            && let Some(subscribed) = self.topics.find_subscribed(&registration.topic)
        {
            subscribed.add_publishers(&uris);
        }
        Ok(())
    }

    /// Returns whether a node answers at a URI.
    async fn is_running(&self, uri: &str) -> bool {
        let Ok(uri) = RpcUri::parse(uri) else { return false };
        rpc::call(&uri, "getPid", vec![(&**self.lifetime.node()).into()]).await.is_ok()
    }

    /// Handles the outcome of a call, and logs changes of the master's state.
    fn handle_outcome(&self, call: &MasterCall, outcome: CallOutcome) {
        let notice = self.registrations().handle_outcome(call, outcome);
        let Some(notice) = notice else { return };
        let (name, master) = (&**self.lifetime.node(), self.master.uri().as_str());
        match notice {
            Notice::MasterUnreachable { reason } => {
                tracing::warn!(
                    node = name,
                    reason,
                    "the ROS master is not reachable; existing connections continue; retrying"
                );
            }
            Notice::MasterReachable => {
                tracing::info!(node = name, master, "the ROS master is reachable again");
            }
            Notice::RegistrationsLost => {
                tracing::warn!(
                    node = name,
                    master,
                    "the ROS master does not know the node any more; registering all topics again"
                );
            }
            Notice::Refused { reason } => {
                tracing::warn!(node = name, reason, "the ROS master refused a registration; retrying");
            }
            Notice::NodeReplaced { uri } => {
                self.lifetime.end(format!("another node, at {uri}, has registered with the same name"));
            }
        }
    }
}
