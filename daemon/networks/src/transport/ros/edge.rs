//! The edge's end of a connection.

use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use peernet_ros::messages::{Message, MessageInfo, SessionHello};
use peernet_ros::ros1::{SubscriberOptions, TopicType};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until, timeout};
use tokio_util::sync::CancellationToken;

use super::channel::Channel;
use super::connection::Event;
use super::connection_task::{ConnectionTask, Directive, Sink};
use super::interface::{
    EdgeTopics, NodeFailure, RemoteNode, SessionNode, SessionPublisher, SessionSubscriber, TopicPurpose,
    end_in_background, open_node,
};
use super::limits::{ReceiveLimits, max_topic_message_bytes, queue_limits};
use super::names::{TopicPair, edge_node_prefix, refusals_topic, sessions_topic, to_ros_name};
use crate::statistics::{ConnectionAddresses, TransportStatistics};
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{
    CLOSED_HERE, DialContext, DialFailure, Disconnection, EdgeConnection, EdgeEvent, EdgeReceiver,
    EdgeSender, Frames, SendFailure, SendOptions, discard_deliveries,
};
use crate::{Address, SessionSettings};

/// First interval between two hellos of an edge. The interval doubles with each hello until the cloud answers.
// The hello is repeated because it is lost if the cloud has not found its publisher yet. In ROS 2 the publisher does
// not know whether the cloud has found it.
const MIN_HELLO_INTERVAL: Duration = Duration::from_millis(10);

/// Longest interval between two hellos of an edge.
const MAX_HELLO_INTERVAL: Duration = Duration::from_millis(500);

/// Number of messages of the largest length that may be incomplete at the same time: messages that are being received,
/// and messages of which only the companion or the payload has arrived.
const MAX_INCOMPLETE_MESSAGES: u64 = 6;

/// Maximum number of deliveries that wait to be received.
const MAX_QUEUED_DELIVERIES: usize = 64;

/// Opens a virtual connection to the cloud that the address names.
pub(crate) async fn dial(
    address: &Address,
    settings: &SessionSettings,
    context: &DialContext<'_>,
) -> Result<EdgeConnection, DialFailure> {
    let id = uuid::Uuid::new_v4().simple().to_string();
    let hello = context.hello;
    let prefix = edge_node_prefix(hello.name.as_str(), hello.pipeline.as_str());
    // Each connection has a node with a different name, because a master shuts a node down when another node registers
    // under the same name. `strip_connection_id` recognizes the eight digits.
    let name = format!("{prefix}{}", &id[..8]);
    let node = open_node(address, &name, settings, context.clock).await?;
    // The guard ends the node even if opening the connection fails, so that the master is informed.
    let node = NodeGuard { node, end_timeout: settings.close_timeout() };
    let pipeline = node.resolve(&to_ros_name(hello.pipeline.as_str()))?;
    let topics = EdgeTopics {
        cloud: address.listener_name().unwrap_or_default().to_owned(),
        request: TopicPair::request(&pipeline),
        response: TopicPair::response(&pipeline),
        node_name_prefix: prefix,
    };
    let cloud = node.find_cloud_and_check_topics(&topics).await?;
    let budget = MemoryBudget::new(settings.max_message_bytes.saturating_mul(MAX_INCOMPLETE_MESSAGES));
    let limits =
        ReceiveLimits { max_message_bytes: max_topic_message_bytes(settings), budget: Arc::clone(&budget) };
    let subscriber_options = limits.subscriber_options(settings, &cloud);
    let opened = open_topics(&topics, &**node, settings, subscriber_options).await?;
    let clock = SharedClock::clone(context.clock);
    let request_topics = (opened.request_companions, topics.request.payload);
    let channel = Channel::new((Arc::clone(&node.node), clock), id.clone(), settings, budget, request_topics);
    let hello_message = SessionHello {
        node: node.name().to_owned(),
        host: hello.host.to_string(),
        pipeline,
        ..SessionHello::default()
    };
    let (mut response_companions, mut refusals) = (opened.response_companions, opened.refusals);
    exchange_hellos(
        &channel,
        (&mut *response_companions, &mut *refusals),
        &*opened.sessions,
        (&cloud, hello_message),
    )
    .await?;
    // After its welcome, the cloud does not refuse this connection any more.
    drop(refusals);
    let (channel, (delivery_sender, deliveries)) = (Arc::new(channel), mpsc::channel(MAX_QUEUED_DELIVERIES));
    let (stop, abort) = (CancellationToken::new(), CancellationToken::new());
    let connection_task = ConnectionTask {
        channel: Arc::clone(&channel),
        companion_subscriber: response_companions,
        payload_subscriber: Some(opened.response_payloads),
        sink: EdgeSink,
        deliveries: delivery_sender,
        stop: stop.clone(),
        abort: abort.clone(),
    };
    let task = tokio::spawn(connection_task.run("the edge closed the connection"));
    let receiver = RosEdgeReceiver { node, deliveries, stop, abort, task: Some(task) };
    Ok(EdgeConnection {
        sender: Box::new(RosEdgeSender(channel)),
        receiver: Box::new(receiver),
        // Only a cloud answers a hello with a welcome.
        peer_is_cloud: true,
    })
}

impl From<NodeFailure> for DialFailure {
    fn from(failure: NodeFailure) -> Self {
        Self::Unreachable(failure.0)
    }
}

/// Publishers and subscribers of an edge for one connection.
struct OpenTopics {
    /// Topic on which the edge asks for the connection.
    sessions: Box<dyn SessionPublisher>,
    request_companions: Box<dyn SessionPublisher>,
    response_companions: Box<dyn SessionSubscriber>,
    response_payloads: Box<dyn SessionSubscriber>,
    /// Topic on which the cloud refuses connections.
    refusals: Box<dyn SessionSubscriber>,
}

/// Opens the topics of a connection.
async fn open_topics(
    topics: &EdgeTopics,
    node: &dyn SessionNode,
    settings: &SessionSettings,
    subscriber_options: SubscriberOptions,
) -> Result<OpenTopics, NodeFailure> {
    let queue = queue_limits(settings);
    let companions = (TopicPurpose::Companions, TopicType::from_message::<MessageInfo>());
    let refusals = (TopicPurpose::Refusals, TopicType::from_message::<MessageInfo>());
    let payloads = (TopicPurpose::Payloads, TopicType::any());
    let sessions = (TopicPurpose::Sessions, TopicType::from_message::<SessionHello>());
    // All topics are opened before the hello is sent, so that no answer is missed.
    Ok(OpenTopics {
        response_companions: node
            .subscribe(&topics.response.info, companions.clone(), subscriber_options.clone())
            .await?,
        response_payloads: node
            .subscribe(&topics.response.payload, payloads, subscriber_options.clone())
            .await?,
        refusals: node.subscribe(&refusals_topic(&topics.cloud), refusals, subscriber_options).await?,
        request_companions: node.publish(&topics.request.info, companions, queue).await?,
        sessions: node.publish(&sessions_topic(&topics.cloud), sessions, queue).await?,
    })
}

/// Says hello until the cloud answers.
async fn exchange_hellos(
    channel: &Channel,
    (response_companions, refusals): (&mut dyn SessionSubscriber, &mut dyn SessionSubscriber),
    sessions: &dyn SessionPublisher,
    (cloud, mut hello): (&Arc<str>, SessionHello),
) -> Result<(), DialFailure> {
    let (mut next_hello, mut interval) = (Instant::now(), MIN_HELLO_INTERVAL);
    let is_from_cloud = |info: &MessageInfo, publisher: &RemoteNode| {
        info.header.frame_id == channel.lock().id() && publisher.node == *cloud
    };
    loop {
        tokio::select! {
            () = sleep_until(next_hello) => {
                // The cloud answers the hello on the request topic with a welcome. The hello on the sessions topic asks
                // for the connection.
                channel.announce(MessageInfo::HELLO);
                hello.header.frame_id = channel.lock().id().to_owned();
                let message = hello.encode(channel.node.form());
                let message = message.map_err(|error| DialFailure::Unreachable(error.to_string()))?;
                sessions.publish(message)?;
                next_hello = Instant::now() + interval;
                interval = (interval * 2).min(MAX_HELLO_INTERVAL);
            }
            message = response_companions.recv() => {
                let message = message?;
                let Ok(info) = MessageInfo::decode(channel.node.form(), message.bytes) else { continue };
                if !is_from_cloud(&info, &message.publisher) {
                    continue;
                }
                let now = channel.now();
                channel.lock().receive_companion(info, now);
                let event = channel.lock().next_event();
                match event {
                    Some(Event::Welcome) => {
                        channel.set_peer(message.publisher);
                        return Ok(());
                    }
                    Some(Event::Gone(reason)) => return Err(DialFailure::Unreachable(reason)),
                    _ => {}
                }
            }
            message = refusals.recv() => {
                let message = message?;
                let Ok(info) = MessageInfo::decode(channel.node.form(), message.bytes) else { continue };
                if is_from_cloud(&info, &message.publisher) {
                    return Err(DialFailure::Refused(peernet_sample::printable_line(&info.reason).into_owned()));
                }
            }
        }
    }
}

/// A node that ends when this guard is dropped. Its registrations are removed in the background.
#[derive(Debug)]
struct NodeGuard {
    node: Arc<dyn SessionNode>,
    end_timeout: Duration,
}

impl std::ops::Deref for NodeGuard {
    type Target = Arc<dyn SessionNode>;

    fn deref(&self) -> &Arc<dyn SessionNode> {
        &self.node
    }
}

impl Drop for NodeGuard {
    fn drop(&mut self) {
        end_in_background(Arc::clone(&self.node), self.end_timeout);
    }
}

#[derive(Debug)]
struct EdgeSink;

impl Sink for EdgeSink {
    type Delivery = (Result<EdgeEvent, Disconnection>, Vec<Reservation>);

    fn handle_event(&mut self, _channel: &Channel, event: Event) -> Option<Self::Delivery> {
        let (delivered_event, reserved) = match event {
            // The cloud repeats the welcome if it receives the hello twice.
            Event::Welcome | Event::Hello => return None,
            Event::Message(frames, reserved) => (Ok(EdgeEvent::Message(frames)), reserved),
            Event::IncomingLost(loss) => (Ok(EdgeEvent::IncomingLost(loss)), Vec::new()),
            Event::OutgoingLost(loss) => (Ok(EdgeEvent::OutgoingLost(loss)), Vec::new()),
            Event::InvalidData(problem) => (Ok(EdgeEvent::InvalidData(problem)), Vec::new()),
            Event::Remark(text) => (Ok(EdgeEvent::Remark(text)), Vec::new()),
            Event::Gone(reason) => (Err(Disconnection(reason)), Vec::new()),
        };
        Some((delivered_event, reserved))
    }

    async fn next_directive(&mut self, _channel: &Arc<Channel>) -> Directive {
        std::future::pending().await
    }
}

#[derive(Debug)]
struct RosEdgeSender(Arc<Channel>);

impl EdgeSender for RosEdgeSender {
    // The deadline of the options is not used, because the topics retransmit lost messages by themselves.
    fn send(&self, frames: Frames, options: SendOptions) -> Result<(), SendFailure> {
        self.0.send(&frames, options)
    }

    fn addresses(&self) -> Option<ConnectionAddresses> {
        self.0.addresses()
    }

    fn caveat(&self) -> Option<&str> {
        self.0.node.caveat()
    }

    fn statistics(&self) -> TransportStatistics {
        self.0.statistics()
    }
}

#[derive(Debug)]
struct RosEdgeReceiver {
    node: NodeGuard,
    deliveries: mpsc::Receiver<<EdgeSink as Sink>::Delivery>,
    stop: CancellationToken,
    abort: CancellationToken,
    task: Option<JoinHandle<()>>,
}

impl Drop for RosEdgeReceiver {
    fn drop(&mut self) {
        self.abort.cancel();
    }
}

impl EdgeReceiver for RosEdgeReceiver {
    fn receive(&mut self) -> BoxFuture<'_, Result<EdgeEvent, Disconnection>> {
        Box::pin(async {
            match self.deliveries.recv().await {
                Some((event, _reserved)) => event,
                None => Err(Disconnection(CLOSED_HERE.into())),
            }
        })
    }

    fn close(mut self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()> {
        Box::pin(async move {
            discard_deliveries(&mut self.deliveries);
            self.stop.cancel();
            if let Some(task) = self.task.take()
                && timeout(linger, task).await.is_err()
            {
                self.abort.cancel();
            }
            // Published messages are sent before the topics end.
            self.node.end(linger).await;
        })
    }
}
