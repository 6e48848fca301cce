//! Nodes of ROS 2 for sessions.
//!
//! ROS 2 needs more than ROS 1, because DDS has no connections:
//!
//! - Each connection of an edge is a separate participant, by which its messages are recognized. A cloud has one
//!   participant for all connections. Companions are always reliable, payloads as configured. The loss of a payload is
//!   detected by its companion.
//! - `rustdds` 0.15.1 sends all fragments of a message at once and retransmits 8 fragments of 256 bytes in 10 ms. Bytes
//!   that do not fit into the receiver's socket buffer therefore arrive at 200 kB/s, if at all. Over loopback with
//!   `net.core.rmem_max` at 4 MiB (of which the kernel makes 8 MiB), messages of 8 MB arrive at once, and messages of
//!   10 MB and more do not arrive within 5 s. Each end therefore states the size of its socket buffers in hello and
//!   welcome. A larger payload is sent as companions of 64 KiB ([`PART`](peernet_ros::messages::MessageInfo::PART)), of
//!   which at most 1 MiB is unacknowledged. Other programs do not see such a payload as a picture, but it arrives as
//!   fast as a payload that fits. Without the split, the slow retransmission of one large message would delay all later
//!   messages.
//! - An end that closes a connection waits for the other end's goodbye before it leaves, because `rustdds` drops unread
//!   messages of a publisher that has left.

mod cloud_search;
mod participant;
mod publisher;
mod publishing_tasks;
mod qos;
mod remote;
mod subscriber;

use std::collections::BTreeSet;
use std::env::var;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use futures::FutureExt;
use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use peernet_ros::messages::WireForm;
use peernet_ros::ros1::{QueueLimits, SubscriberOptions, TopicType};
use peernet_ros::ros2::{EndpointRole, ParticipantId, Ros2Error, Ros2Settings, absolute_topic};
use tokio::sync::watch;

use self::cloud_search::{check_cloud_name, find_cloud_and_check_topics};
use self::participant::Participant;
use self::publisher::Ros2SessionPublisher;
use self::publishing_tasks::PublishingTasks;
use self::qos::SessionQos;
use self::subscriber::Ros2SessionSubscriber;
use super::interface::{
    EdgeTopics, NodeFailure, SessionNode, SessionPublisher, SessionSubscriber, TopicPurpose,
};
use crate::{Address, SessionSettings};

/// Time limit of the search for a cloud. Discovery takes less than a second where multicast works, and an edge repeats
/// the search.
const MAX_CLOUD_SEARCH_TIME: Duration = Duration::from_secs(2);

/// Maximum number of bytes of frames in a companion. Longer frames are split, so that each companion fits into any
/// socket buffer.
pub(super) const MAX_COMPANION_BYTES: usize = 64 * 1024;

/// A node with the topics of sessions in a domain.
pub(super) struct Ros2SessionNode {
    participant: Participant,
    namespace: String,
    qos: SessionQos,
    cloud_search_timeout: Duration,
    publishing_tasks: PublishingTasks,
    clock: SharedClock,
}

impl fmt::Debug for Ros2SessionNode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.participant.name();
        formatter.debug_struct("Ros2SessionNode").field("name", &name).finish_non_exhaustive()
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
        // Names in ROS 2 cannot have two successive underscores.
        let name_parts: Vec<&str> = name.split('_').filter(|part| !part.is_empty()).collect();
        let participant = Participant::join(Ros2Settings {
            domain_id: address.ros_domain(),
            interfaces: settings.ros2.interfaces.clone(),
            node_name: name_parts.join("_"),
            namespace: namespace.clone(),
            socket_buffer_bytes: usize::try_from(settings.socket_buffer_bytes).unwrap_or(usize::MAX),
            ..Ros2Settings::default()
        });
        Ok(Self {
            participant: participant.await?,
            namespace,
            qos: SessionQos::new(&settings.ros2),
            // The other half of the time is for the handshake.
            cloud_search_timeout: MAX_CLOUD_SEARCH_TIME.min(settings.open_timeout() / 2),
            publishing_tasks: PublishingTasks::default(),
            clock: SharedClock::clone(clock),
        })
    }
}

/// Returns the name of a type in ROS 2, such as `std_msgs/msg/String` for `std_msgs/String`.
fn ros2_type_name(name: &str) -> String {
    name.replacen('/', "/msg/", 1)
}

impl SessionNode for Ros2SessionNode {
    fn form(&self) -> WireForm {
        WireForm::Cdr
    }

    fn name(&self) -> &str {
        self.participant.name()
    }

    fn describe(&self, node: &str) -> String {
        let Ok(local_node) = self.participant.node() else { return format!("participant {node}") };
        remote::describe(&local_node, node)
    }

    fn readable_names(&self, node: &str) -> Vec<String> {
        let (local_node, id) = (self.participant.node(), node.parse());
        local_node
            .ok()
            .zip(id.ok())
            .map(|(local_node, id): (_, ParticipantId)| local_node.nodes_of(id))
            .unwrap_or_default()
    }

    fn resolve(&self, name: &str) -> Result<String, NodeFailure> {
        Ok(absolute_topic(&self.namespace, self.participant.name(), name)?)
    }

    fn find_cloud_and_check_topics<'a>(
        &'a self,
        topics: &'a EdgeTopics,
    ) -> BoxFuture<'a, Result<Arc<str>, NodeFailure>> {
        find_cloud_and_check_topics(&self.participant, topics, self.cloud_search_timeout).boxed()
    }

    fn check_cloud_name<'a>(&'a self, cloud: &'a str) -> BoxFuture<'a, Result<(), NodeFailure>> {
        check_cloud_name(&self.participant, cloud).boxed()
    }

    fn receive_buffer_bytes(&self) -> Option<usize> {
        Some(self.participant.receive_buffer_bytes())
    }

    fn max_companion_bytes(&self) -> usize {
        MAX_COMPANION_BYTES
    }

    fn payload_timeout(&self) -> Option<Duration> {
        self.qos.payload_timeout()
    }

    fn caveat(&self) -> Option<&str> {
        self.participant.caveat()
    }

    fn publish<'a>(
        &'a self,
        topic: &'a str,
        (purpose, kind): (TopicPurpose, TopicType),
        queue: QueueLimits,
    ) -> BoxFuture<'a, Result<Box<dyn SessionPublisher>, NodeFailure>> {
        let open = || {
            let qos = self.qos.profile(EndpointRole::Publisher, purpose);
            let publisher =
                self.participant.node()?.create_publisher(topic, &ros2_type_name(&kind.name), &qos)?;
            let clock = SharedClock::clone(&self.clock);
            let publisher = Ros2SessionPublisher::new(publisher, queue.bytes, clock, &self.publishing_tasks);
            Ok(Box::new(publisher) as Box<dyn SessionPublisher>)
        };
        std::future::ready(open()).boxed()
    }

    fn subscribe<'a>(
        &'a self,
        topic: &'a str,
        (purpose, kind): (TopicPurpose, TopicType),
        options: SubscriberOptions,
    ) -> BoxFuture<'a, Result<Box<dyn SessionSubscriber>, NodeFailure>> {
        let open = || {
            let (node, qos) =
                (self.participant.node()?, self.qos.profile(EndpointRole::Subscription, purpose));
            let subscriber = match kind.is_any() {
                true => Ros2SessionSubscriber::with_any_type(&node, topic, qos, &options),
                false => {
                    let subscription = node.create_subscription(topic, &ros2_type_name(&kind.name), &qos)?;
                    Ros2SessionSubscriber::from_subscription(&node, subscription, kind.name, &options)
                }
            };
            Ok(Box::new(subscriber) as Box<dyn SessionSubscriber>)
        };
        std::future::ready(open()).boxed()
    }

    fn end(&self, time_limit: Duration) -> BoxFuture<'_, ()> {
        let end = async move {
            if !self.publishing_tasks.finish(time_limit).await {
                let node = self.participant.name();
                tracing::debug!(node, "a ROS 2 node ends before its last messages were acknowledged");
            }
            self.participant.leave();
        };
        end.boxed()
    }

    fn close(&self) {
        self.participant.leave();
    }
}

/// Names of the participants whose messages arrive.
type PublisherNames = watch::Receiver<BTreeSet<Arc<str>>>;
