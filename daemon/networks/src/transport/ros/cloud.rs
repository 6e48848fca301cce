//! The cloud's end of all connections to one listener name.
//!
//! An address names the master and the cloud, because a topic has no host. The cloud's node has a fixed name; the nodes
//! of edges have random names.

mod connection_table;
mod payload_subscription;
mod peers;
mod refusals;
mod sink;
mod tasks;

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use peernet_ros::messages::{Message, MessageInfo, SessionHello, WireForm};
use peernet_ros::ros1::{QueueLimits, SubscriberOptions, TopicType, WhenFull};
use tokio::sync::mpsc;

use self::connection_table::Admission;
use self::peers::{Delivery, Peers};
use self::tasks::CloudTasks;
use super::interface::{
    NodeFailure, SessionNode, SessionPublisher, SessionSubscriber, TopicMessage, TopicPurpose, open_node,
};
use super::names::{cloud_node, refusals_topic, sessions_topic};
use crate::descriptors::DescriptorShare;
use crate::statistics::TransportStatistics;
use crate::transport::{
    BindFailure, BoundPort, CloudReceiver, CloudSender, ConnectionId, Frames, ListenerEvent, Peer,
    SendFailure, SendOptions, discard_deliveries,
};
use crate::{Address, SessionSettings};

/// Maximum number of deliveries that wait to be received.
const MAX_QUEUED_DELIVERIES: usize = 64;

/// Largest request for a connection. Bytes.
const MAX_HELLO_BYTES: usize = 4 * 1024;

/// Maximum number of queued requests. Further requests are dropped, because edges repeat them.
const MAX_QUEUED_HELLOS: usize = 64;

/// Number of TCP sockets of an edge's connection: one for each of its topics.
const SOCKETS_PER_CONNECTION: usize = 5;

/// Opens the cloud's node and its topics under the address's name.
pub(crate) async fn bind(
    address: &Address,
    settings: &SessionSettings,
    ports: NonZeroUsize,
    clock: &SharedClock,
) -> Result<BoundPort, BindFailure> {
    let bind_failure = |error: NodeFailure| BindFailure::Other(error.to_string());
    let name = address.listener_name().unwrap_or_default();
    let node = open_node(address, &cloud_node(name), settings, clock).await.map_err(bind_failure)?;
    let (sessions, refusals) = match open_topics(&*node, name).await {
        Ok(topics) => topics,
        Err(failure) => {
            // In ROS 1, this unregisters the node's topics and waits until its tasks have ended. Dropping the node
            // would do neither.
            node.end(settings.close_timeout()).await;
            return Err(bind_failure(failure));
        }
    };
    let caveat = node.caveat().map(str::to_owned);
    let (delivery_sender, deliveries) = mpsc::channel(MAX_QUEUED_DELIVERIES);
    // At least one connection is allowed, however few descriptors the process may open.
    let max_connections =
        (DescriptorShare::DataPort.max_connections_per_port(ports) / SOCKETS_PER_CONNECTION).max(1);
    let tasks = CloudTasks::default();
    let peers = Peers::new(
        (Arc::clone(&node), SharedClock::clone(clock)),
        (settings.clone(), max_connections),
        (refusals, delivery_sender),
        tasks.clone(),
    );
    let peers = Arc::new(peers);
    tasks.spawn(accept_connections(Arc::clone(&peers), Arc::clone(&node), sessions, tasks.clone()));
    let sender = Box::new(RosCloudSender(peers));
    let receiver = Box::new(RosCloudReceiver { node, deliveries, tasks });
    Ok(BoundPort { address: address.clone(), caveat, sender, receiver })
}

/// Checks that no other cloud has the name `cloud`, and opens the topics of requests and of refusals.
async fn open_topics(
    node: &dyn SessionNode,
    cloud: &str,
) -> Result<(Box<dyn SessionSubscriber>, Box<dyn SessionPublisher>), NodeFailure> {
    node.check_cloud_name(cloud).await?;
    // Each refusal answers a hello, so both queues have the same limits.
    let queue = QueueLimits { messages: MAX_QUEUED_HELLOS, bytes: MAX_QUEUED_HELLOS * MAX_HELLO_BYTES };
    let options = SubscriberOptions {
        queue,
        when_full: WhenFull::Drop,
        max_message_bytes: MAX_HELLO_BYTES,
        ..Default::default()
    };
    let sessions_kind = (TopicPurpose::Sessions, TopicType::from_message::<SessionHello>());
    let sessions = node.subscribe(&sessions_topic(cloud), sessions_kind, options).await?;
    let refusals_kind = (TopicPurpose::Refusals, TopicType::from_message::<MessageInfo>());
    let refusals = node.publish(&refusals_topic(cloud), refusals_kind, queue).await?;
    Ok((sessions, refusals))
}

/// Opens a connection for each edge that asks for a connection.
async fn accept_connections(
    peers: Arc<Peers>,
    node: Arc<dyn SessionNode>,
    mut sessions: Box<dyn SessionSubscriber>,
    tasks: CloudTasks,
) {
    loop {
        tokio::select! {
            () = tasks.wait_for_stop() => return,
            message = sessions.recv() => match message {
                Ok(message) => handle_hello(&peers, node.form(), message),
                Err(error) => {
                    tracing::error!(%error, node = node.name(), "cannot receive further requests for connections; the port closes");
                    tasks.abort();
                    return;
                }
            },
        }
    }
}

fn handle_hello(peers: &Arc<Peers>, form: WireForm, message: TopicMessage) {
    let TopicMessage { bytes, publisher, .. } = message;
    match SessionHello::decode(form, bytes) {
        // A node may request a connection only for itself.
        Ok(hello) if *hello.node == *publisher.node => peers.open(hello, &publisher),
        Ok(hello) => {
            let problem =
                format!("node {} asked for a connection in the name of {}", publisher.node, hello.node);
            peers.report_invalid(publisher.remote, &problem);
        }
        Err(error) => {
            let problem =
                format!("cannot decode the request of node {} for a connection: {error}", publisher.node);
            peers.report_invalid(publisher.remote, &problem);
        }
    }
}

#[derive(Debug)]
struct RosCloudSender(Arc<Peers>);

impl CloudSender for RosCloudSender {
    fn send(&self, peer: &Peer, frames: Frames, options: SendOptions) -> Result<(), SendFailure> {
        match self.0.channel(peer.connection) {
            Some(channel) => channel.send(&frames, options),
            None => Err(SendFailure::Gone("the connection is closed".into())),
        }
    }

    fn note_hello(&self, connection: ConnectionId) {
        self.0.set_admission(connection, Admission::Greeted);
    }

    fn admit(&self, connection: ConnectionId) {
        self.0.set_admission(connection, Admission::Admitted);
    }

    fn demote(&self, connection: ConnectionId) {
        self.0.set_admission(connection, Admission::Unadmitted);
    }

    fn statistics(&self, connection: ConnectionId) -> TransportStatistics {
        self.0.channel(connection).map(|channel| channel.statistics()).unwrap_or_default()
    }
}

#[derive(Debug)]
struct RosCloudReceiver {
    node: Arc<dyn SessionNode>,
    deliveries: mpsc::Receiver<Delivery>,
    tasks: CloudTasks,
}

impl Drop for RosCloudReceiver {
    fn drop(&mut self) {
        self.tasks.abort();
        self.node.close();
    }
}

impl CloudReceiver for RosCloudReceiver {
    fn receive(&mut self) -> BoxFuture<'_, Option<ListenerEvent>> {
        Box::pin(async {
            tokio::select! {
                // The choice is biased, so that events before the abort are still delivered.
                biased;
                delivery = self.deliveries.recv() => delivery.map(|(event, _reserved)| event),
                () = self.tasks.wait_for_abort() => None,
            }
        })
    }

    fn close(mut self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()> {
        Box::pin(async move {
            discard_deliveries(&mut self.deliveries);
            self.tasks.close(linger).await;
            self.node.end(linger).await;
        })
    }
}
