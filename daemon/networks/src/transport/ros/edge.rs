//! The edge's end of a connection.

use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use peernet_ros::messages::{Message, MessageInfo, SessionHello, WireForm};
use peernet_ros::ros1::{
    Node, NodeError, Publisher, PublisherOptions, Subscriber, SubscriberOptions, TopicType,
};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until, timeout};
use tokio_util::sync::CancellationToken;

use super::channel::{Channel, ReceiveLimits, largest_message, queue_limits};
use super::connection::Event;
use super::environment;
use super::names::{TopicPair, allowed, base_name, cloud_node, edge_node_prefix, sessions_topic};
use super::serving::{Directive, Serving, Sink};
use crate::statistics::{ConnectionAddresses, TransportStatistics};
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{
    DialFailure, Dialled, Dialler, Disconnected, EdgeArrival, EdgeReceiver, EdgeSender, Frames, SendFailure,
    SendOptions,
};
use crate::{Address, SessionSettings};

/// Time between the first two times that an edge says hello. It doubles until the edge is welcome.
const MIN_HELLO_INTERVAL: Duration = Duration::from_millis(10);

/// Longest time between two times that an edge says hello.
const MAX_HELLO_INTERVAL: Duration = Duration::from_millis(500);

/// Largest messages of the cloud that may be received, or of which one half may be held, at once.
const INCOMPLETE_MESSAGES: u64 = 6;

/// Arrivals that wait to be received.
const QUEUED_ARRIVALS: usize = 64;

/// Opens a virtual connection to the cloud with the address's name.
pub(crate) async fn dial(
    address: &Address,
    settings: &SessionSettings,
    dialler: &Dialler<'_>,
) -> Result<Dialled, DialFailure> {
    let id = uuid::Uuid::new_v4().simple().to_string();
    let hello = dialler.hello;
    let prefix = edge_node_prefix(hello.name.as_str(), hello.pipeline.as_str());
    let environment = environment(address).map_err(|error| DialFailure::Unreachable(error.to_string()))?;
    let name = format!("{prefix}{}", &id[..8]);
    let node = Node::new(&environment, &name, SharedClock::clone(dialler.clock))
        .await
        .map_err(|error| unreachable(&error))?;
    // However dialling ends, the master is told.
    let node = NodeGuard { node: Arc::new(node), patience: settings.close_timeout() };
    let pipeline = node.resolve(&allowed(hello.pipeline.as_str())).map_err(|error| unreachable(&error))?;
    let topics = Topics {
        cloud: address.listener_name().unwrap_or_default().to_owned(),
        request: TopicPair::request(&pipeline),
        response: TopicPair::response(&pipeline),
    };
    let cloud = topics.check(&node, &prefix, address).await?;
    let budget = MemoryBudget::new(settings.max_message_bytes.saturating_mul(INCOMPLETE_MESSAGES));
    let limits = ReceiveLimits { max_message_bytes: largest_message(settings), budget: Arc::clone(&budget) };
    let receiving = limits.subscriber_options(settings, &cloud);
    let opened = topics.open(&node, settings, receiving).await.map_err(|error| unreachable(&error))?;
    let clock = SharedClock::clone(dialler.clock);
    let sending = (opened.request_info, topics.request.payload);
    let channel = Channel::new((Arc::clone(&node.node), clock), id.clone(), settings, budget, sending);
    let wire = SessionHello {
        node: node.name().to_owned(),
        host: hello.host.to_string(),
        pipeline,
        ..SessionHello::default()
    };
    let mut response_info = opened.response_info;
    welcome(&channel, &mut response_info, &opened.sessions, wire).await?;
    let (channel, (deliveries, arrivals)) = (Arc::new(channel), mpsc::channel(QUEUED_ARRIVALS));
    let (stop, abort) = (CancellationToken::new(), CancellationToken::new());
    let serving = Serving {
        channel: Arc::clone(&channel),
        info: response_info,
        payload: Some(opened.response),
        sink: EdgeSink,
        deliveries,
        stop: stop.clone(),
        abort: abort.clone(),
    };
    let task = tokio::spawn(serving.run("the edge closed the connection"));
    let receiver = RosEdgeReceiver { node, arrivals, stop, abort, task: Some(task) };
    Ok(Dialled { sender: Box::new(RosEdgeSender(channel)), receiver: Box::new(receiver) })
}

fn unreachable(error: &NodeError) -> DialFailure {
    DialFailure::Unreachable(error.to_string())
}

/// The topics of a connection.
struct Topics {
    cloud: String,
    request: TopicPair,
    response: TopicPair,
}

/// What an edge has of them.
struct Opened {
    sessions: Publisher,
    request_info: Publisher,
    response_info: Subscriber,
    response: Subscriber,
}

impl Topics {
    /// Checks with the master that the cloud is there, and that nobody else uses the pipeline's topics. Returns the name of
    /// the cloud's node.
    async fn check(&self, node: &Node, own_prefix: &str, address: &Address) -> Result<Arc<str>, DialFailure> {
        let state = node.system_state().await.map_err(|error| unreachable(&error))?;
        let sessions = sessions_topic(&self.cloud);
        let is_cloud = |node: &&String| base_name(node) == cloud_node(&self.cloud);
        let clouds: Vec<String> = state.subscribers_of(&sessions).iter().filter(is_cloud).cloned().collect();
        let mut clouds = node.running_nodes(&clouds).await.map_err(|error| unreachable(&error))?;
        let Some(cloud) = clouds.pop() else {
            return Err(DialFailure::Unreachable(format!(
                "the ROS master at {} knows no cloud with the name {}: nobody subscribes to {sessions}; start it with \
                 this master and name",
                address.authority(),
                self.cloud
            )));
        };
        let is_foreign = |node: &&String| !base_name(node).starts_with(own_prefix);
        for topic in [&self.request.info, &self.request.payload] {
            let others: Vec<String> = state.publishers_of(topic).iter().filter(is_foreign).cloned().collect();
            if let Some(other) =
                node.running_nodes(&others).await.map_err(|error| unreachable(&error))?.first()
            {
                return Err(DialFailure::Unreachable(format!(
                    "node {other} publishes topic {topic} already; stop it, give the pipeline another name, or set \
                     ROS_NAMESPACE to a namespace of this robot"
                )));
            }
        }
        let types = node.topic_types().await.map_err(|error| unreachable(&error))?;
        let expected = MessageInfo::DEFINITION.name;
        for topic in [&self.request.info, &self.response.info] {
            let is_used = !state.publishers_of(topic).is_empty() || !state.subscribers_of(topic).is_empty();
            let other = types.iter().find(|(name, kind)| name == topic && kind != expected && kind != "*");
            if let Some((_, kind)) = other.filter(|_| is_used) {
                return Err(DialFailure::Unreachable(format!(
                    "topic {topic} has the message type {kind} and would need {expected}; give the pipeline another name, \
                     or set ROS_NAMESPACE to a namespace of this robot"
                )));
            }
        }
        Ok(cloud.into())
    }

    async fn open(
        &self,
        node: &Node,
        settings: &SessionSettings,
        receiving: SubscriberOptions,
    ) -> Result<Opened, NodeError> {
        let sending = PublisherOptions { is_latching: false, queue: queue_limits(settings) };
        let info = TopicType::of::<MessageInfo>();
        Ok(Opened {
            response_info: node.subscribe(&self.response.info, info.clone(), receiving.clone()).await?,
            response: node.subscribe(&self.response.payload, TopicType::any(), receiving).await?,
            request_info: node.publish(&self.request.info, info, sending).await?,
            sessions: node
                .publish(&sessions_topic(&self.cloud), TopicType::of::<SessionHello>(), sending)
                .await?,
        })
    }
}

/// Says hello until the cloud answers.
async fn welcome(
    channel: &Channel,
    response_info: &mut Subscriber,
    sessions: &Publisher,
    mut hello: SessionHello,
) -> Result<(), DialFailure> {
    let (mut next, mut interval) = (Instant::now(), MIN_HELLO_INTERVAL);
    loop {
        tokio::select! {
            () = sleep_until(next) => {
                channel.announce(MessageInfo::HELLO);
                hello.header.frame_id = channel.lock().id().to_owned();
                let message = hello.encode(WireForm::Ros1);
                let message = message.map_err(|error| DialFailure::Unreachable(error.to_string()))?;
                sessions.publish(message).map_err(|error| unreachable(&error))?;
                next = Instant::now() + interval;
                interval = (interval * 2).min(MAX_HELLO_INTERVAL);
            }
            message = response_info.recv() => {
                let message = message.map_err(|error| unreachable(&error))?;
                let Ok(info) = MessageInfo::decode(WireForm::Ros1, message.bytes) else { continue };
                if info.header.frame_id != channel.lock().id() {
                    continue;
                }
                let now = channel.now();
                channel.lock().hear_info(info, now);
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
        }
    }
}

/// A node that ends when this is dropped; the master is told in the background.
#[derive(Debug)]
struct NodeGuard {
    node: Arc<Node>,
    patience: Duration,
}

impl std::ops::Deref for NodeGuard {
    type Target = Node;

    fn deref(&self) -> &Node {
        &self.node
    }
}

impl Drop for NodeGuard {
    fn drop(&mut self) {
        match tokio::runtime::Handle::try_current() {
            Ok(runtime) => {
                let (node, patience) = (Arc::clone(&self.node), self.patience);
                runtime.spawn(async move { end_node(&node, patience).await });
            }
            Err(_) => self.node.close(),
        }
    }
}

/// Ends a node, whose registrations the master forgets if it answers in time.
pub(super) async fn end_node(node: &Node, patience: Duration) {
    match timeout(patience, node.shutdown()).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::debug!(%error, node = node.name(), "a node stays in the master's lists"),
        Err(_) => tracing::debug!(node = node.name(), "a node stays in the master's lists"),
    }
}

#[derive(Debug)]
struct EdgeSink;

impl Sink for EdgeSink {
    type Delivery = (Result<EdgeArrival, Disconnected>, Vec<Reservation>);

    fn take(&mut self, _channel: &Channel, event: Event) -> Option<Self::Delivery> {
        let (arrival, reserved) = match event {
            // The cloud repeats it when it has heard hello twice.
            Event::Welcome | Event::Hello => return None,
            Event::Message(frames, reserved) => (Ok(EdgeArrival::Message(frames)), reserved),
            Event::Incomplete(loss) => (Ok(EdgeArrival::Incomplete(loss)), Vec::new()),
            Event::Lost(loss) => (Ok(EdgeArrival::Lost(loss)), Vec::new()),
            Event::Garbage(problem) => (Ok(EdgeArrival::Garbage(problem)), Vec::new()),
            Event::Gone(reason) => (Err(Disconnected(reason)), Vec::new()),
        };
        Some((arrival, reserved))
    }

    async fn wait(&mut self) -> Directive {
        std::future::pending().await
    }
}

#[derive(Debug)]
struct RosEdgeSender(Arc<Channel>);

impl EdgeSender for RosEdgeSender {
    // TCP repeats what is lost: the deadline is of no use.
    fn send(&self, frames: Frames, options: SendOptions) -> Result<(), SendFailure> {
        self.0.send(&frames, options)
    }

    fn addresses(&self) -> Option<ConnectionAddresses> {
        self.0.addresses()
    }

    fn statistics(&self) -> TransportStatistics {
        self.0.statistics()
    }
}

#[derive(Debug)]
struct RosEdgeReceiver {
    node: NodeGuard,
    arrivals: mpsc::Receiver<<EdgeSink as Sink>::Delivery>,
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
    fn receive(&mut self) -> BoxFuture<'_, Result<EdgeArrival, Disconnected>> {
        Box::pin(async {
            match self.arrivals.recv().await {
                Some((arrival, _reserved)) => arrival,
                None => Err(Disconnected("the connection was closed here".into())),
            }
        })
    }

    fn close(mut self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()> {
        Box::pin(async move {
            // What still arrives is of no use; the task must not wait until it is received.
            self.arrivals.close();
            while self.arrivals.try_recv().is_ok() {}
            self.stop.cancel();
            if let Some(task) = self.task.take()
                && timeout(linger, task).await.is_err()
            {
                self.abort.cancel();
            }
            // What was published goes out before the topics end.
            end_node(&self.node, linger).await;
        })
    }
}
