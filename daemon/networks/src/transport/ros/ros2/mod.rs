//! Nodes of ROS 2.

mod publisher;
mod subscriber;

use std::collections::BTreeSet;
use std::env::var;
use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use futures::FutureExt;
use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use peernet_ros::messages::{Message, MessageInfo, SessionHello, WireForm};
use peernet_ros::ros1::{QueueLimits, SubscriberOptions, TopicType};
use peernet_ros::ros2::{
    EndpointRole, ParticipantId, QosProfile, Reliability, Ros2Error, Ros2Node, Ros2Settings, absolute_topic,
};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use self::publisher::Ros2SessionPublisher;
use self::subscriber::Ros2SessionSubscriber;
use super::interface::{
    EdgeTopics, NodeFailure, RemoteNode, SessionNode, SessionPublisher, SessionSubscriber, TopicUse,
};
use super::names::sessions_topic;
use crate::settings::Ros2SessionSettings;
use crate::{Address, SessionSettings};

/// Time in which a cloud, or another one with the same name, is looked for. Discovery takes less than a second where multicast works;
/// whoever asks tries again.
const FIND_CLOUD: Duration = Duration::from_secs(2);
const FIND_OTHER_CLOUD: Duration = Duration::from_secs(1);

/// Time in which others that use the topics of a pipeline are looked for once the cloud is found.
const FIND_OTHERS: Duration = Duration::from_millis(250);

/// Companions that may be received and not yet handed on: those of a large payload come in many parts.
const COMPANION_DEPTH: u32 = 256;

/// Bytes of frames in a companion; what is longer is split, so that each fits into any socket's buffer.
pub(super) const MAX_COMPANION_BYTES: usize = 64 * 1024;

/// Participants of this process. Their publishers on the topics of a pipeline are those of its earlier connections.
static OWN: Mutex<BTreeSet<ParticipantId>> = Mutex::new(BTreeSet::new());

fn own() -> MutexGuard<'static, BTreeSet<ParticipantId>> {
    OWN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A participant of a domain.
pub(super) struct Ros2SessionNode {
    /// Present until the node has ended.
    node: Mutex<Option<Arc<Ros2Node>>>,
    id: ParticipantId,
    name: String,
    namespace: String,
    settings: Ros2SessionSettings,
    receive_buffer_bytes: usize,
    caveat: Option<String>,
    find_cloud: Duration,
    /// Publishers that still have to send.
    tasks: TaskTracker,
    /// They end when they have sent it.
    stop: CancellationToken,
    clock: SharedClock,
}

impl fmt::Debug for Ros2SessionNode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Ros2SessionNode").field("name", &self.name).finish_non_exhaustive()
    }
}

impl From<Ros2Error> for NodeFailure {
    fn from(error: Ros2Error) -> Self {
        Self(error.to_string())
    }
}

impl Ros2SessionNode {
    /// Joins the address's domain.
    pub(super) async fn open(
        address: &Address,
        name: &str,
        settings: &SessionSettings,
        clock: &SharedClock,
    ) -> Result<Self, NodeFailure> {
        let namespace = var("ROS_NAMESPACE").unwrap_or_default();
        let namespace = format!("/{}", namespace.trim_matches('/'));
        // Names of ROS 2 have no two underscores in a row.
        let words: Vec<&str> = name.split('_').filter(|word| !word.is_empty()).collect();
        let node = Ros2Node::new(Ros2Settings {
            domain_id: address.domain(),
            interfaces: settings.ros2.interfaces.clone(),
            node_name: words.join("_"),
            namespace: namespace.clone(),
            socket_buffer_bytes: usize::try_from(settings.socket_buffer_bytes).unwrap_or(usize::MAX),
            ..Ros2Settings::default()
        });
        let node = node.await?;
        let id = node.id();
        own().insert(id);
        Ok(Self {
            id,
            name: id.to_string(),
            namespace,
            settings: settings.ros2.clone(),
            receive_buffer_bytes: node.receive_buffer_bytes(),
            caveat: node.socket_buffer_warnings().first().map(ToString::to_string),
            find_cloud: FIND_CLOUD.min(settings.open_timeout() / 2),
            tasks: TaskTracker::new(),
            stop: CancellationToken::new(),
            clock: SharedClock::clone(clock),
            node: Mutex::new(Some(Arc::new(node))),
        })
    }

    fn node(&self) -> Result<Arc<Ros2Node>, NodeFailure> {
        let node = self.node.lock().unwrap_or_else(PoisonError::into_inner);
        node.clone().ok_or_else(|| NodeFailure("the node of ROS 2 has left its domain".to_owned()))
    }

    /// Companions are always reliable: they keep account of what becomes of the payloads.
    fn qos(&self, role: EndpointRole, topic_use: TopicUse) -> QosProfile {
        match (topic_use, role) {
            (TopicUse::Sessions | TopicUse::Companions, _) => {
                QosProfile { depth: COMPANION_DEPTH, ..QosProfile::default() }
            }
            (TopicUse::Payloads, EndpointRole::Publisher) => QosProfile {
                reliability: self.settings.reliability,
                depth: self.settings.depth,
                deadline_ms: self.settings.deadline_ms.map(|ms| ms as f64),
                ..QosProfile::default()
            },
            // A deadline is offered and not requested, so that both ends need not agree on one.
            (TopicUse::Payloads, EndpointRole::Subscription) => QosProfile {
                reliability: self.settings.reliability,
                depth: self.settings.depth,
                ..QosProfile::default()
            },
        }
    }

    async fn cloud(&self, topics: &EdgeTopics) -> Result<Arc<str>, NodeFailure> {
        let node = self.node()?;
        let sessions = sessions_topic(&topics.cloud);
        let clouds = || clouds_of(&node, &sessions);
        // A cloud that has just ended may still be seen.
        let found = await_discovery(&node, self.find_cloud, || clouds().len() == 1).await;
        if found.is_err() && clouds().is_empty() {
            return Err(NodeFailure(format!(
                "{} has no cloud with the name {}: nobody subscribes to {sessions} within {} s; {}",
                node.describe_domain(),
                topics.cloud,
                self.find_cloud.as_secs_f64(),
                node.advise(),
            )));
        }
        // DDS tells of no end of discovery, and others than the cloud may be found a little later.
        sleep(FIND_OTHERS).await;
        self.check(&node, topics)?;
        let clouds = clouds();
        match clouds.first() {
            Some(cloud) if clouds.len() == 1 => Ok(cloud.to_string().into()),
            _ => Err(NodeFailure(format!(
                "{} clouds serve the name {} in {}; stop all but one, or give each a name of its own",
                clouds.len(),
                topics.cloud,
                node.describe_domain(),
            ))),
        }
    }

    /// Checks that no other program uses the topics of a pipeline.
    fn check(&self, node: &Ros2Node, topics: &EdgeTopics) -> Result<(), NodeFailure> {
        let remedy = "give the pipeline another name, or set ROS_NAMESPACE to a namespace of this robot";
        let expected = ros2_name(MessageInfo::DEFINITION.name);
        for topic in [&topics.request.info, &topics.response.info] {
            if let Some(other) = node.endpoints_of(topic).iter().find(|found| found.type_name != expected) {
                let of = other.node.as_ref().map(|name| format!(" for node {name}")).unwrap_or_default();
                return Err(NodeFailure(format!(
                    "topic {topic} has the message type {}{of} and would need {expected}; {remedy}",
                    other.type_name
                )));
            }
        }
        for topic in [&topics.request.info, &topics.request.payload] {
            let publishers = node.publishers_of(topic);
            let is_foreign = |id: ParticipantId| id != self.id && !own().contains(&id);
            if let Some(other) = publishers.iter().find(|found| is_foreign(found.id.participant())) {
                let host = other.host.map_or_else(|| "this host".to_owned(), |host| format!("host {host}"));
                let publisher = match &other.node {
                    Some(name) => format!("node {name}"),
                    None => {
                        format!("a program without a known node (participant {})", other.id.participant())
                    }
                };
                return Err(NodeFailure(format!(
                    "{publisher} on {host} publishes topic {topic} already; stop it, {remedy}"
                )));
            }
        }
        Ok(())
    }

    async fn other_cloud(&self, cloud: &str) -> Result<(), NodeFailure> {
        let node = self.node()?;
        let sessions = sessions_topic(cloud);
        // Not as soon as one is seen: it may just be ending.
        sleep(FIND_OTHER_CLOUD).await;
        match clouds_of(&node, &sessions).is_empty() {
            true => Ok(()),
            false => Err(NodeFailure(format!(
                "another cloud serves the name {cloud} in {} already; stop it, or end the address with another name",
                node.describe_domain()
            ))),
        }
    }

    async fn leave(&self, patience: Duration) {
        self.stop.cancel();
        self.tasks.close();
        if timeout(patience, self.tasks.wait()).await.is_err() {
            tracing::debug!(node = self.name, "the last messages of a node of ROS 2 were not acknowledged");
        }
        self.close();
    }
}

/// Other participants that subscribe to requests for connections.
fn clouds_of(node: &Ros2Node, sessions: &str) -> BTreeSet<ParticipantId> {
    let expected = ros2_name(SessionHello::DEFINITION.name);
    let is_cloud = |role, kind: &str| role == EndpointRole::Subscription && kind == expected;
    let found = node.endpoints_of(sessions).into_iter();
    found.filter(|found| is_cloud(found.role, &found.type_name)).map(|found| found.id.participant()).collect()
}

/// Names the nodes of a participant for people, as `node /viewer`.
fn describe(node: &Ros2Node, participant: &str) -> String {
    let known = participant.parse().map(|id: ParticipantId| (node.nodes_of(id), node.host_of(id)));
    let (names, host) = known.unwrap_or_default();
    let host = host.map(|host| format!(" on host {host}")).unwrap_or_default();
    match &names[..] {
        [] => format!("participant {participant}{host}"),
        [name] => format!("node {name}{host}"),
        names => format!("one of the nodes {}{host}", names.join(", ")),
    }
}

/// Waits until discovery has found out something.
async fn await_discovery(
    node: &Ros2Node,
    patience: Duration,
    is_found: impl Fn() -> bool,
) -> Result<(), tokio::time::error::Elapsed> {
    let mut changes = node.discovery_changes();
    let found = async {
        while !is_found() {
            if changes.changed().await.is_err() {
                std::future::pending::<()>().await;
            }
        }
    };
    timeout(patience, found).await
}

/// The name that ROS 2 has for a type: `std_msgs/msg/String` for `std_msgs/String`.
fn ros2_name(name: &str) -> String {
    name.replacen('/', "/msg/", 1)
}

/// Name and addresses of a participant. Its host is the one that it announces; ports mean nothing.
fn remote_node(node: &Ros2Node, id: ParticipantId) -> RemoteNode {
    let loopback = IpAddr::V4(Ipv4Addr::LOCALHOST);
    let remote = SocketAddr::new(node.host_of(id).unwrap_or(loopback), 0);
    let local = local_address(remote).unwrap_or(SocketAddr::new(loopback, 0));
    RemoteNode { node: id.to_string().into(), local, remote }
}

/// The address from which packets to another one leave. Nothing is sent.
fn local_address(remote: SocketAddr) -> Option<SocketAddr> {
    let any = if remote.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let socket = UdpSocket::bind(any).ok()?;
    socket.connect(SocketAddr::new(remote.ip(), 9)).ok()?;
    Some(SocketAddr::new(socket.local_addr().ok()?.ip(), 0))
}

impl SessionNode for Ros2SessionNode {
    fn form(&self) -> WireForm {
        WireForm::Cdr
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn describe(&self, node: &str) -> String {
        let Ok(own) = self.node() else { return format!("participant {node}") };
        describe(&own, node)
    }

    fn names(&self, node: &str) -> Vec<String> {
        let (own, id) = (self.node(), node.parse());
        own.ok().zip(id.ok()).map(|(own, id): (_, ParticipantId)| own.nodes_of(id)).unwrap_or_default()
    }

    fn resolve(&self, name: &str) -> Result<String, NodeFailure> {
        Ok(absolute_topic(&self.namespace, &self.name, name)?)
    }

    fn find_cloud<'a>(&'a self, topics: &'a EdgeTopics) -> BoxFuture<'a, Result<Arc<str>, NodeFailure>> {
        self.cloud(topics).boxed()
    }

    fn check_cloud_name<'a>(&'a self, cloud: &'a str) -> BoxFuture<'a, Result<(), NodeFailure>> {
        self.other_cloud(cloud).boxed()
    }

    fn receive_buffer_bytes(&self) -> Option<usize> {
        Some(self.receive_buffer_bytes)
    }

    fn max_companion_bytes(&self) -> usize {
        MAX_COMPANION_BYTES
    }

    fn payload_patience(&self) -> Option<Duration> {
        let is_reliable = self.settings.reliability == Reliability::Reliable;
        let default = (!is_reliable).then_some(Duration::from_secs(1));
        self.settings.deadline_ms.map(Duration::from_millis).or(default)
    }

    fn caveat(&self) -> Option<&str> {
        self.caveat.as_deref()
    }

    fn publish<'a>(
        &'a self,
        topic: &'a str,
        (topic_use, kind): (TopicUse, TopicType),
        queue: QueueLimits,
    ) -> BoxFuture<'a, Result<Box<dyn SessionPublisher>, NodeFailure>> {
        let open = || {
            let qos = self.qos(EndpointRole::Publisher, topic_use);
            let publisher = self.node()?.publisher(topic, &ros2_name(&kind.name), &qos)?;
            let clock = SharedClock::clone(&self.clock);
            let publisher =
                Ros2SessionPublisher::new(publisher, queue.bytes, clock, (&self.tasks, self.stop.clone()));
            Ok(Box::new(publisher) as Box<dyn SessionPublisher>)
        };
        std::future::ready(open()).boxed()
    }

    fn subscribe<'a>(
        &'a self,
        topic: &'a str,
        (topic_use, kind): (TopicUse, TopicType),
        options: SubscriberOptions,
    ) -> BoxFuture<'a, Result<Box<dyn SessionSubscriber>, NodeFailure>> {
        let open = || {
            let (node, qos) = (self.node()?, self.qos(EndpointRole::Subscription, topic_use));
            let subscriber = match kind.is_any() {
                true => Ros2SessionSubscriber::of_any_type(&node, topic, qos, &options),
                false => {
                    let subscription = node.subscription(topic, &ros2_name(&kind.name), &qos)?;
                    Ros2SessionSubscriber::of(&node, subscription, kind.name, &options)
                }
            };
            Ok(Box::new(subscriber) as Box<dyn SessionSubscriber>)
        };
        std::future::ready(open()).boxed()
    }

    fn end(&self, patience: Duration) -> BoxFuture<'_, ()> {
        self.leave(patience).boxed()
    }

    // Dropping the node leaves the domain on a thread of its own.
    fn close(&self) {
        let node = self.node.lock().unwrap_or_else(PoisonError::into_inner).take();
        own().remove(&self.id);
        drop(node);
    }
}

impl Drop for Ros2SessionNode {
    fn drop(&mut self) {
        self.close();
    }
}

/// Participants of which messages arrive, by the names of their nodes.
type Publishers = watch::Receiver<BTreeSet<Arc<str>>>;
