//! A ROS 2 node: a participant of a DDS domain.

use std::pin::pin;
use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use futures::StreamExt;
use rustdds::no_key::{DataWriter, SimpleDataReader};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent,
    DomainParticipantStatusListener, Publisher, RTPSEntity, StatusEvented, Subscriber, Topic, TopicKind,
};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::conversions::{endpoint_id, incompatibility, qos_policies};
use super::endpoint::Endpoint;
use super::interfaces::{Interfaces, check_socket_buffers};
use super::publisher::Ros2Publisher;
use super::raw_message::{RawAdapter, RawMessage};
use super::sequence_tracker::SequenceTracker;
use super::subscription::Ros2Subscription;
use crate::ros2::discovery::{DiscoveryEvent, DiscoveryState};
use crate::ros2::names::{absolute_topic, dds_topic, dds_type};
use crate::ros2::node_list::{self, ListEntry, OwnEntry};
use crate::ros2::{
    Durability, EndpointId, EndpointRole, ParticipantId, QosProfile, ReceiveCounts, Ros2Error, Ros2Settings,
    SocketBufferWarning,
};

/// A node of ROS 2.
///
/// A node has four threads of `rustdds`. When the node ends, its publishers and subscriptions end, too.
pub struct Ros2Node {
    settings: Ros2Settings,
    socket_buffer_warnings: Vec<SocketBufferWarning>,
    pub(super) state: Arc<NodeState>,
    /// Present until the node is shut down.
    pub(super) entities: Option<DdsEntities>,
}

/// The objects of `rustdds` that exist until the node is shut down, and the tasks that read from them.
pub(super) struct DdsEntities {
    pub(super) participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    /// Task that applies the events of discovery.
    discovery_task: JoinHandle<()>,
    /// Task that reads the node list.
    node_list_task: JoinHandle<()>,
}

/// State that the endpoints of a node share.
pub(super) struct NodeState {
    pub(super) id: ParticipantId,
    pub(super) domain_id: u16,
    /// Description of the network interfaces, such as `lo (127.0.0.1)`.
    pub(super) interfaces: String,
    /// Cancelled when the node is shut down.
    pub(super) closed: CancellationToken,
    discovery: Mutex<DiscoveryState>,
    node_list: Mutex<NodeListPublisher>,
}

/// Reader of the node list.
type ListReader = SimpleDataReader<RawMessage, RawAdapter>;

/// Maximum number of entries of the node list that are received and not yet read.
const MAX_UNREAD_ENTRIES: u32 = 1_024;

/// Publisher of our entry of the node list.
struct NodeListPublisher {
    writer: DataWriter<RawMessage, RawAdapter>,
    entry: OwnEntry,
}

impl Ros2Node {
    /// Joins a DDS domain and adds itself to the node list of ROS 2.
    ///
    /// # Errors
    ///
    /// If settings or environment variables are invalid, or the domain cannot be joined.
    pub async fn new(settings: Ros2Settings) -> Result<Self, Ros2Error> {
        let settings = settings.with_environment(|name| std::env::var(name).ok())?;
        let domain_id = settings.domain_id.unwrap_or(0);
        let interfaces = Interfaces::find(&settings.interfaces)?;
        let join_error = |reason: String| Ros2Error::Join {
            domain_id,
            interfaces: interfaces.description.clone(),
            reason,
        };
        let socket_buffer_warnings = check_socket_buffers(settings.socket_buffer_bytes)
            .map_err(|error| join_error(error.to_string()))?;
        let builder = participant_builder(&settings, &interfaces);
        // The participant is built on a blocking thread, because building waits for threads to start.
        let participant = tokio::task::spawn_blocking(move || builder.build())
            .await
            .map_err(|error| join_error(error.to_string()))?
            .map_err(|error| join_error(error.to_string()))?;
        Self::join(settings, interfaces.description.clone(), socket_buffer_warnings, participant)
            .map_err(|error| join_error(error.to_string()))
    }

    fn join(
        settings: Ros2Settings,
        interfaces: String,
        socket_buffer_warnings: Vec<SocketBufferWarning>,
        participant: DomainParticipant,
    ) -> rustdds::dds::CreateResult<Self> {
        let qos = |role| qos_policies(role, &QosProfile::default());
        let publisher = participant.create_publisher(&qos(EndpointRole::Publisher))?;
        let subscriber = participant.create_subscriber(&qos(EndpointRole::Subscription))?;
        let (node_list, entries) =
            NodeListPublisher::new(&settings, &participant, (&publisher, &subscriber))?;
        let id = endpoint_id(participant.guid()).participant();
        let state = Arc::new(NodeState {
            id,
            domain_id: participant.domain_id(),
            interfaces,
            closed: CancellationToken::new(),
            discovery: Mutex::new(DiscoveryState::new(id)),
            node_list: Mutex::new(node_list),
        });
        state.publish_node_list();
        let discovery_task =
            tokio::spawn(follow_discovery(participant.status_listener(), Arc::clone(&state)));
        let node_list_task = tokio::spawn(follow_node_list(entries, Arc::clone(&state)));
        let entities =
            Some(DdsEntities { participant, publisher, subscriber, discovery_task, node_list_task });
        Ok(Self { settings, socket_buffer_warnings, state, entities })
    }

    /// Returns the settings, completed by the environment variables.
    pub fn settings(&self) -> &Ros2Settings {
        &self.settings
    }

    /// Returns limits of the kernel that are below the requested socket buffers.
    pub fn socket_buffer_warnings(&self) -> &[SocketBufferWarning] {
        &self.socket_buffer_warnings
    }

    /// Returns the size of the receive buffer of a socket on this host. Subscriptions on this host lose parts of
    /// messages that are larger than the buffer.
    pub fn receive_buffer_bytes(&self) -> usize {
        let warning = self.socket_buffer_warnings.iter().find(|warning| warning.limits_receive_buffer());
        warning.map_or(self.settings.socket_buffer_bytes, |warning| warning.granted)
    }

    /// Returns the identity of the node in the domain.
    pub fn id(&self) -> ParticipantId {
        self.state.id
    }

    /// Returns the number of other participants of the domain.
    pub fn participant_count(&self) -> usize {
        self.state.discovery().participant_count()
    }

    /// Creates a publisher of a topic. `type_name` has the form `std_msgs/msg/String`.
    ///
    /// # Errors
    ///
    /// If names or the QoS profile are invalid, or `rustdds` fails.
    pub fn create_publisher(
        &self,
        topic: &str,
        type_name: &str,
        qos: &QosProfile,
    ) -> Result<Ros2Publisher, Ros2Error> {
        let role = EndpointRole::Publisher;
        let (entities, names, dds_topic) = self.open_topic(role, topic, type_name, qos)?;
        let mut discovery = self.state.discovery();
        let writer = entities
            .publisher
            .create_datawriter_no_key(&dds_topic, Some(qos_policies(role, qos)))
            .map_err(|error| names.create_error(role, &error))?;
        let id = endpoint_id(writer.guid());
        // The lock of `discovery` is held until the endpoint is added, so that no event about the endpoint is handled
        // before.
        let peers = discovery.add_local(id, role, &names.dds_type);
        drop(discovery);
        self.state.publish_node_list();
        let (topic, type_name) = (names.topic, type_name.to_owned());
        let endpoint = Endpoint { id, role, topic, type_name, peers, node: Arc::clone(&self.state) };
        // The receive buffers of peers are unknown. They are assumed to be as large as the buffer of this host. Half of
        // this size is a margin.
        let half_buffer = self.receive_buffer_bytes() / 2;
        let max_unacknowledged_bytes = half_buffer.min(Ros2Publisher::MAX_UNACKNOWLEDGED_BYTES);
        let (qos, unacknowledged_bytes) = (qos.clone(), AtomicUsize::new(0));
        Ok(Ros2Publisher { writer, endpoint, qos, unacknowledged_bytes, max_unacknowledged_bytes })
    }

    /// Creates a subscription of a topic. `type_name` has the form `std_msgs/msg/String`.
    ///
    /// # Errors
    ///
    /// If names or the QoS profile are invalid, or `rustdds` fails.
    pub fn create_subscription(
        &self,
        topic: &str,
        type_name: &str,
        qos: &QosProfile,
    ) -> Result<Ros2Subscription, Ros2Error> {
        let role = EndpointRole::Subscription;
        let (entities, names, dds_topic) = self.open_topic(role, topic, type_name, qos)?;
        let mut discovery = self.state.discovery();
        let reader = entities
            .subscriber
            .create_simple_datareader_no_key(&dds_topic, Some(qos_policies(role, qos)))
            .map_err(|error| names.create_error(role, &error))?;
        let id = endpoint_id(reader.guid());
        // The lock is held for the same reason as in `create_publisher`.
        let peers = discovery.add_local(id, role, &names.dds_type);
        drop(discovery);
        self.state.publish_node_list();
        let (topic, type_name) = (names.topic, type_name.to_owned());
        let endpoint = Endpoint { id, role, topic, type_name, peers, node: Arc::clone(&self.state) };
        let (tracker, counts) = (SequenceTracker::default(), ReceiveCounts::default());
        Ok(Ros2Subscription { reader, endpoint, tracker, counts })
    }

    fn open_topic(
        &self,
        role: EndpointRole,
        topic: &str,
        type_name: &str,
        qos: &QosProfile,
    ) -> Result<(&DdsEntities, TopicNames, Topic), Ros2Error> {
        let topic = absolute_topic(&self.settings.namespace, &self.settings.node_name, topic)?;
        let names = TopicNames { topic, dds_type: dds_type(type_name)? };
        qos.check().map_err(|source| Ros2Error::InvalidQos { topic: names.topic.clone(), source })?;
        let Some(entities) = &self.entities else {
            return Err(Ros2Error::ShutDown { topic: names.topic });
        };
        let dds_topic = entities
            .participant
            .create_topic(
                dds_topic(&names.topic),
                names.dds_type.clone(),
                &qos_policies(role, qos),
                TopicKind::NoKey,
            )
            .map_err(|error| names.create_error(role, &error))?;
        Ok((entities, names, dds_topic))
    }

    /// Leaves the domain. Publishers and subscriptions of the node fail from now on. Messages that are not acknowledged
    /// yet are not sent again (see [`Ros2Publisher::wait_for_acknowledgment`]).
    ///
    /// # Errors
    ///
    /// If a thread of `rustdds` panicked.
    pub async fn shut_down(mut self) -> Result<(), Ros2Error> {
        self.state.closed.cancel();
        let Some(entities) = self.entities.take() else { return Ok(()) };
        let leave_error = |reason: String| Ros2Error::Leave { domain_id: self.state.domain_id, reason };
        for task in [entities.discovery_task, entities.node_list_task] {
            task.await.map_err(|error| leave_error(error.to_string()))?;
        }
        let participant = entities.participant;
        // The participant is dropped on a blocking thread, because dropping waits for the threads of rustdds to end.
        tokio::task::spawn_blocking(move || drop(participant))
            .await
            .map_err(|error| leave_error(error.to_string()))
    }
}

impl Drop for Ros2Node {
    fn drop(&mut self) {
        self.state.closed.cancel();
        if let Some(entities) = self.entities.take() {
            // Dropping the participant waits for the threads of rustdds, which must not block a thread of tokio.
            let name = "leaving ROS 2".to_owned();
            if let Err(error) = std::thread::Builder::new().name(name).spawn(move || drop(entities)) {
                tracing::warn!(
                    %error,
                    "cannot start a thread to leave the ROS 2 domain; leaving it on a thread of the runtime"
                );
            }
        }
    }
}

/// Names of a topic and its type.
struct TopicNames {
    /// Absolute name.
    topic: String,
    dds_type: String,
}

impl TopicNames {
    fn create_error(&self, role: EndpointRole, error: &rustdds::dds::CreateError) -> Ros2Error {
        Ros2Error::Create { role, topic: self.topic.clone(), reason: error.to_string() }
    }
}

impl NodeState {
    pub(super) fn discovery(&self) -> MutexGuard<'_, DiscoveryState> {
        self.discovery.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn remove_endpoint(&self, id: EndpointId) {
        self.discovery().remove_local(id);
        self.publish_node_list();
    }

    /// Publishes our entry of the node list.
    fn publish_node_list(&self) {
        if self.closed.is_cancelled() {
            return;
        }
        // The lock is taken before the endpoints are read, so a newer list is never followed by an older list.
        let mut list = self.node_list.lock().unwrap_or_else(PoisonError::into_inner);
        list.entry.endpoints = self.discovery().local_endpoints();
        let Some(message) = RawMessage::from_payload(list.entry.to_payload()) else { return };
        if let Err(error) = list.writer.write(message, Some(rustdds::Timestamp::now())) {
            tracing::warn!(
                error = %error.forget_data(),
                "cannot publish the ROS 2 node list; other participants see an old list of this node"
            );
        }
    }
}

impl NodeListPublisher {
    fn new(
        settings: &Ros2Settings,
        participant: &DomainParticipant,
        (publisher, subscriber): (&Publisher, &Subscriber),
    ) -> rustdds::dds::CreateResult<(Self, ListReader)> {
        let qos = QosProfile {
            depth: 1,
            durability: Durability::TransientLocal,
            // The list is published from destructors, which must not wait.
            max_blocking_ms: 0,
            ..QosProfile::default()
        };
        // The topic has no keys, so the reader keeps the entries of all participants in one history. The depth is
        // therefore large.
        let reader_qos = QosProfile { depth: MAX_UNREAD_ENTRIES, ..qos };
        let reader_qos = qos_policies(EndpointRole::Subscription, &reader_qos);
        let qos = qos_policies(EndpointRole::Publisher, &qos);
        let (topic, type_name) = (node_list::TOPIC.to_owned(), node_list::TYPE_NAME.to_owned());
        let topic = participant.create_topic(topic, type_name, &qos, TopicKind::NoKey)?;
        let entry = OwnEntry {
            participant: endpoint_id(participant.guid()),
            namespace: settings.namespace.clone(),
            name: settings.node_name.clone(),
            identifier_length: settings.identifier_length(),
            endpoints: Vec::new(),
        };
        let reader = subscriber.create_simple_datareader_no_key(&topic, Some(reader_qos))?;
        Ok((Self { writer: publisher.create_datawriter_no_key(&topic, Some(qos))?, entry }, reader))
    }
}

fn participant_builder(settings: &Ros2Settings, interfaces: &Interfaces) -> DomainParticipantBuilder {
    let builder = DomainParticipantBuilder::new(settings.domain_id.unwrap_or(0))
        .same_host_loopback(interfaces.include_loopback())
        .socket_receive_buffer_size(settings.socket_buffer_bytes)
        .socket_send_buffer_size(settings.socket_buffer_bytes);
    if interfaces.addresses.is_empty() {
        builder
    } else {
        builder.with_only_networks(interfaces.addresses.clone())
    }
}

/// Applies the events of discovery to the endpoints until the node is shut down.
async fn follow_discovery(listener: DomainParticipantStatusListener, state: Arc<NodeState>) {
    let mut events = listener.as_async_status_stream();
    while let Some(Some(event)) = state.closed.run_until_cancelled(events.next()).await {
        if let Some(event) = discovery_event(event) {
            tracing::debug!(?event, "discovery of ROS 2");
            let mut discovery = state.discovery();
            let ignored_before = discovery.ignored_count();
            discovery.apply(event);
            let ignored = discovery.ignored_count();
            // The warning appears only when the number has doubled, because every host on the network can announce
            // objects.
            if ignored > ignored_before && ignored.is_power_of_two() {
                tracing::warn!(
                    ignored,
                    "the ROS 2 domain {} has more participants or topics than are stored; those beyond the \
                     limits, and their nodes, remain unknown",
                    state.domain_id
                );
            }
        }
    }
}

/// Applies the node list until the node is shut down. Invalid entries are counted. A warning is logged whenever their
/// number has doubled.
async fn follow_node_list(reader: ListReader, state: Arc<NodeState>) {
    let mut entries = pin!(reader.as_async_stream());
    let mut dropped = 0_u64;
    while let Some(Some(entry)) = state.closed.run_until_cancelled(entries.next()).await {
        let entry = entry.map_err(|error| error.to_string()).and_then(|message| {
            let sender = endpoint_id(message.writer_guid()).participant();
            match ListEntry::decode(&message.into_value().0) {
                // A participant may only list its own nodes; otherwise it could rename other participants' nodes.
                Ok(entry) if entry.participant == sender => Ok(entry),
                Ok(_) => Err(format!("participant {sender} lists nodes of another participant")),
                Err(error) => Err(format!("the entry of participant {sender} cannot be read: {error}")),
            }
        });
        match entry {
            Ok(entry) => state.discovery().apply(DiscoveryEvent::NodesListed(entry)),
            Err(error) => {
                dropped += 1;
                if dropped.is_power_of_two() {
                    tracing::warn!(
                        error,
                        dropped,
                        "ignoring an entry of the ROS 2 node list; its nodes are named by the identity of their participant"
                    );
                }
            }
        }
    }
}

fn discovery_event(event: DomainParticipantStatusEvent) -> Option<DiscoveryEvent> {
    use DomainParticipantStatusEvent as Event;
    let participant = |prefix: &[u8]| prefix.try_into().ok().map(ParticipantId);
    Some(match event {
        Event::ParticipantDiscovered { dpd } => {
            DiscoveryEvent::ParticipantDiscovered(endpoint_id(dpd.guid).participant())
        }
        Event::ParticipantLost { id, .. } => DiscoveryEvent::ParticipantLost(participant(id.as_ref())?),
        Event::ReaderDetected { reader: endpoint } | Event::WriterDetected { writer: endpoint } => {
            DiscoveryEvent::EndpointDiscovered {
                id: endpoint_id(endpoint.guid),
                topic: endpoint.topic_name,
                type_name: endpoint.type_name,
            }
        }
        Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => {
            DiscoveryEvent::EndpointLost(endpoint_id(guid))
        }
        Event::RemoteReaderMatched { local_writer, remote_reader } => {
            DiscoveryEvent::Matched { local: endpoint_id(local_writer), remote: endpoint_id(remote_reader) }
        }
        Event::RemoteWriterMatched { local_reader, remote_writer } => {
            DiscoveryEvent::Matched { local: endpoint_id(local_reader), remote: endpoint_id(remote_writer) }
        }
        Event::RemoteReaderQosIncompatible { local_writer, remote_reader, requested_qos, offered_qos } => {
            DiscoveryEvent::Incompatible {
                local: endpoint_id(local_writer),
                remote: endpoint_id(remote_reader),
                refusal: incompatibility(&offered_qos, &requested_qos),
            }
        }
        Event::RemoteWriterQosIncompatible { local_reader, remote_writer, requested_qos, offered_qos } => {
            DiscoveryEvent::Incompatible {
                local: endpoint_id(local_reader),
                remote: endpoint_id(remote_writer),
                refusal: incompatibility(&offered_qos, &requested_qos),
            }
        }
        // The remaining events are summaries of these events, or concern security, which is off.
        _ => return None,
    })
}
