//! The edges of a cloud, and their connections.

use std::net::SocketAddr;
use std::sync::Arc;

use peernet_clock::SharedClock;
use peernet_ros::messages::{MessageInfo, SessionHello};
use peernet_ros::ros1::TopicType;
use tokio::sync::mpsc;

use super::connection_table::{Admission, CloudConnection, ConnectionTable, OpenOutcome};
use super::payload_subscription::PayloadSubscription;
use super::refusals::Refusals;
use super::sink::CloudSink;
use super::tasks::CloudTasks;
use crate::SessionSettings;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::ros::channel::Channel;
use crate::transport::ros::connection_task::ConnectionTask;
use crate::transport::ros::interface::{
    NodeFailure, RemoteNode, SessionNode, SessionPublisher, TopicPurpose,
};
use crate::transport::ros::limits::{
    INFO_OVERHEAD_BYTES, ReceiveLimits, max_topic_message_bytes, queue_limits,
};
use crate::transport::ros::names::TopicPair;
use crate::transport::{AddressGroup, ConnectionId, ListenerEvent, Peer};

/// Largest companion before a session. Bytes.
const MAX_UNADMITTED_BYTES: usize = 64 * 1024 + INFO_OVERHEAD_BYTES;

/// Number of companions of that length that a connection without a session may hold: one is being received while
/// another waits.
const MAX_UNADMITTED_MESSAGES: usize = 2;

/// Memory of all connections without a session. Bytes.
const MAX_ALL_UNADMITTED_BYTES: usize = 16 * 1024 * 1024;

/// An event for the layer above, and the reservations of its memory.
pub(super) type Delivery = (ListenerEvent, Vec<Reservation>);

/// All connections of a cloud.
#[derive(Debug)]
pub(super) struct Peers {
    node: Arc<dyn SessionNode>,
    clock: SharedClock,
    settings: SessionSettings,
    /// Limits of connections with a session, which share the memory.
    admitted_limits: ReceiveLimits,
    table: ConnectionTable,
    refusals: Refusals,
    deliveries: mpsc::Sender<Delivery>,
    tasks: CloudTasks,
}

impl Peers {
    pub(super) fn new(
        (node, clock): (Arc<dyn SessionNode>, SharedClock),
        (settings, max_connections): (SessionSettings, usize),
        (refusal_publisher, deliveries): (Box<dyn SessionPublisher>, mpsc::Sender<Delivery>),
        tasks: CloudTasks,
    ) -> Self {
        // A message of the largest length must fit even if `max_unfinished_bytes` is smaller.
        let budget = MemoryBudget::new(settings.max_unfinished_bytes.max(settings.max_message_bytes));
        let admitted_limits = ReceiveLimits { max_message_bytes: max_topic_message_bytes(&settings), budget };
        // Half of the connections are left for edges with a session.
        let max_unadmitted = (max_connections / 2)
            .min(MAX_ALL_UNADMITTED_BYTES / (MAX_UNADMITTED_BYTES * MAX_UNADMITTED_MESSAGES));
        let table = ConnectionTable::new(max_connections, max_unadmitted);
        let node_and_clock = (Arc::clone(&node), SharedClock::clone(&clock));
        let refusals = Refusals::new(node_and_clock, refusal_publisher, deliveries.clone());
        Self { node, clock, settings, admitted_limits, table, refusals, deliveries, tasks }
    }

    pub(super) fn channel(&self, connection: ConnectionId) -> Option<Arc<Channel>> {
        self.table.find(connection)?.channel()
    }

    pub(super) fn set_admission(&self, connection: ConnectionId, admission: Admission) {
        if let Some(connection) = self.table.find(connection) {
            connection.set_admission(admission);
        }
    }

    /// Reports invalid data of a node to the layer above.
    pub(super) fn report_invalid(&self, from: SocketAddr, problem: &str) {
        let event =
            ListenerEvent::InvalidData(Some(from), peernet_sample::printable_line(problem).into_owned());
        if self.deliveries.try_send((event, Vec::new())).is_err() {
            tracing::debug!(%from, problem, "an invalid message is not counted, because the queue of events is full");
        }
    }

    /// Opens a connection that an edge asks for. An edge repeats its request until the request is answered.
    pub(super) fn open(self: &Arc<Self>, hello: SessionHello, edge: &RemoteNode) {
        let group = AddressGroup::from_address(edge.remote);
        let (connection, replaced) = match self.table.open(&hello, group, self.tasks.abort_token()) {
            OpenOutcome::Repeated => return,
            OpenOutcome::Refused(reason) => return self.refusals.refuse(&hello, edge, reason),
            OpenOutcome::Started { connection, replaced } => (connection, replaced),
        };
        let (peers, edge) = (Arc::clone(self), edge.clone());
        self.tasks.spawn(async move {
            if let Some(replaced) = replaced {
                // The topics of the replaced connection have the same names.
                replaced.wait_for_end().await;
            }
            if let Err(error) = peers.serve(&connection, &hello.pipeline, &edge).await {
                peers.refusals.refuse_after_failure(&hello, &edge, &error.to_string());
            }
            peers.table.remove(&hello.pipeline, &connection);
            connection.end();
            // The connection may have ended by itself and been reported before; a second report has no effect.
            let end_event = ListenerEvent::Gone(connection.id(), "the connection has ended".to_owned());
            let _ = peers.deliveries.send((end_event, Vec::new())).await;
        });
    }

    /// Opens the topics of a connection, and runs the connection until its end.
    async fn serve(
        &self,
        connection: &CloudConnection,
        pipeline: &str,
        edge: &RemoteNode,
    ) -> Result<(), NodeFailure> {
        let (request, response) = (TopicPair::request(pipeline), TopicPair::response(pipeline));
        let kind = (TopicPurpose::Companions, TopicType::from_message::<MessageInfo>());
        let publisher = self.node.publish(&response.info, kind.clone(), queue_limits(&self.settings)).await?;
        // This connection has a separate budget, so that an edge without a session takes no memory from sessions, or
        // from other edges without a session.
        let budget = MemoryBudget::new((MAX_UNADMITTED_BYTES * MAX_UNADMITTED_MESSAGES) as u64);
        let unadmitted_limits =
            ReceiveLimits { max_message_bytes: MAX_UNADMITTED_BYTES, budget: Arc::clone(&budget) };
        let options = unadmitted_limits.subscriber_options(&self.settings, &edge.node);
        let companion_subscriber = self.node.subscribe(&request.info, kind, options).await?;
        let node_and_clock = (Arc::clone(&self.node), SharedClock::clone(&self.clock));
        // The edge chose the identifier, which its companions carry. `connection.id()` is a number of this cloud.
        let (identifier, sending) = (connection.identifier().to_owned(), (publisher, response.payload));
        let channel = Arc::new(Channel::new(node_and_clock, identifier, &self.settings, budget, sending));
        channel.set_peer(edge.clone());
        connection.set_channel(Arc::clone(&channel));
        let peer = Peer { connection: connection.id(), address: Some(edge.remote) };
        let payloads = PayloadSubscription::Unused {
            node: Arc::clone(&self.node),
            topic: request.payload,
            options: self.admitted_limits.subscriber_options(&self.settings, &edge.node),
        };
        let sink = CloudSink::new(
            (peer, connection.watch_admission()),
            self.settings.hello_timeout(),
            (unadmitted_limits, self.admitted_limits.clone()),
            payloads,
        );
        let connection_task = ConnectionTask {
            channel,
            companion_subscriber,
            payload_subscriber: None,
            sink,
            deliveries: self.deliveries.clone(),
            stop: self.tasks.stop_token(),
            abort: connection.abort_token(),
        };
        connection_task.run("the cloud shuts down").await;
        Ok(())
    }
}
