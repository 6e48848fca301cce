//! The connections of a cloud.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_clock::{LogThrottle, SharedClock};
use peernet_ros::messages::{Header, Message, MessageInfo, SessionHello};
use peernet_ros::ros1::{SubscriberOptions, TopicType};
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, sleep, sleep_until};
use tokio_util::sync::CancellationToken;
use tokio_util::task::{AbortOnDropHandle, TaskTracker};

use super::channel::Channel;
use super::connection::Event;
use super::interface::{NodeFailure, RemoteNode, SessionNode, SessionPublisher, SessionSubscriber, TopicUse};
use super::limits::{INFO_OVERHEAD_BYTES, ReceiveLimits, largest_message, queue_limits};
use super::names::TopicPair;
use super::payload_topic::{MASTER_RETRY, payload_topic_closed};
use super::serving::{Directive, Serving, Sink};
use crate::SessionSettings;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{AddressGroup, Arrival, ConnectionId, Peer};

/// Largest companion before a session. Bytes.
const MAX_UNADMITTED_BYTES: usize = 64 * 1024 + INFO_OVERHEAD_BYTES;

/// Companions of that length that a connection without a session holds: one is being received while another waits.
const MAX_UNADMITTED_MESSAGES: usize = 2;

/// Memory of all connections without a session. Bytes.
const MAX_ALL_UNADMITTED_BYTES: usize = 16 * 1024 * 1024;

/// What is handed up, with the memory that it holds.
pub(super) type Delivery = (Arrival, Vec<Reservation>);

/// What a connection's sessions entitle it to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Standing {
    Unadmitted,
    Greeted,
    Admitted,
}

/// All connections of a cloud.
#[derive(Debug)]
pub(super) struct Peers {
    node: Arc<dyn SessionNode>,
    clock: SharedClock,
    settings: SessionSettings,
    budget: Arc<MemoryBudget>,
    max_connections: usize,
    table: Mutex<Table>,
    /// Tells edges that they get no connection.
    refusals: Box<dyn SessionPublisher>,
    deliveries: mpsc::Sender<Delivery>,
    stop: CancellationToken,
    abort: CancellationToken,
    tasks: TaskTracker,
}

#[derive(Debug, Default)]
struct Table {
    next: u64,
    /// By the global names of their pipelines.
    entries: BTreeMap<String, Arc<Entry>>,
    log_throttle: LogThrottle,
}

#[derive(Debug)]
struct Entry {
    connection: ConnectionId,
    id: String,
    host: String,
    /// Of the edge.
    group: AddressGroup,
    /// From the time when the topics are open until the connection has ended.
    channel: Mutex<Option<Arc<Channel>>>,
    standing: watch::Sender<Standing>,
    abort: CancellationToken,
    ended: CancellationToken,
}

impl Entry {
    fn channel(&self) -> MutexGuard<'_, Option<Arc<Channel>>> {
        self.channel.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Peers {
    pub(super) fn new(
        (node, clock): (Arc<dyn SessionNode>, SharedClock),
        (settings, budget, max_connections): (SessionSettings, Arc<MemoryBudget>, usize),
        (refusals, deliveries): (Box<dyn SessionPublisher>, mpsc::Sender<Delivery>),
        (stop, abort, tasks): (CancellationToken, CancellationToken, TaskTracker),
    ) -> Self {
        let table = Mutex::default();
        Self {
            node,
            clock,
            settings,
            budget,
            max_connections,
            table,
            refusals,
            deliveries,
            stop,
            abort,
            tasks,
        }
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn entry(&self, connection: ConnectionId) -> Option<Arc<Entry>> {
        self.table().entries.values().find(|entry| entry.connection == connection).cloned()
    }

    pub(super) fn channel(&self, connection: ConnectionId) -> Option<Arc<Channel>> {
        self.entry(connection)?.channel().clone()
    }

    pub(super) fn set_standing(&self, connection: ConnectionId, standing: Standing) {
        if let Some(entry) = self.entry(connection) {
            entry.standing.send_replace(standing);
        }
    }

    /// Hands up that a node sent something that makes no sense.
    pub(super) fn garbage(&self, from: SocketAddr, problem: &str) {
        let garbage = Arrival::Garbage(Some(from), peernet_sample::printable_line(problem).into_owned());
        if self.deliveries.try_send((garbage, Vec::new())).is_err() {
            tracing::debug!(%from, problem, "a message that makes no sense is not counted, because nobody receives");
        }
    }

    /// Opens a connection that an edge asks for. An edge repeats its request until it is welcome.
    pub(super) fn open(self: &Arc<Self>, hello: SessionHello, edge: &RemoteNode) {
        let mut table = self.table();
        let id = &hello.header.frame_id;
        let earlier = table.entries.get(&hello.pipeline).cloned();
        if earlier.as_ref().is_some_and(|entry| entry.id == *id) {
            return;
        }
        let group = AddressGroup::of(edge.remote);
        if let Some(reason) = self.reason_to_refuse(&table, &hello, group) {
            let address = Some(edge.remote.ip());
            let is_new = table.log_throttle.count(reason, address, self.clock.mono()).is_some();
            drop(table);
            self.refuse(&hello, edge, reason, is_new);
            return;
        }
        let connection = ConnectionId(table.next);
        table.next += 1;
        let entry = Arc::new(Entry {
            connection,
            id: hello.header.frame_id.clone(),
            host: hello.host.clone(),
            group,
            channel: Mutex::default(),
            standing: watch::Sender::new(Standing::Unadmitted),
            abort: self.abort.child_token(),
            ended: CancellationToken::new(),
        });
        table.entries.insert(hello.pipeline.clone(), Arc::clone(&entry));
        drop(table);
        if let Some(earlier) = &earlier {
            earlier.abort.cancel();
        }
        let (peers, edge) = (Arc::clone(self), edge.clone());
        self.tasks.spawn(async move {
            if let Some(earlier) = earlier {
                // Its topics have the same names.
                earlier.ended.cancelled().await;
            }
            if let Err(error) = peers.serve(&entry, &hello.pipeline, &edge).await {
                peers.refuse(&hello, &edge, &error.to_string(), true);
            }
            peers.forget(&hello.pipeline, &entry);
            // The next connection publishes the same topics.
            entry.channel().take();
            entry.ended.cancel();
            // The connection may have ended by itself, which was told then; telling it twice does no harm.
            let gone = Arrival::Gone(entry.connection, "the connection has ended".to_owned());
            let _ = peers.deliveries.send((gone, Vec::new())).await;
        });
    }

    /// Tells an edge, which repeats its request, that it gets no connection; what is new is handed up as well.
    fn refuse(&self, hello: &SessionHello, edge: &RemoteNode, reason: &str, is_new: bool) {
        let header = Header { frame_id: hello.header.frame_id.clone(), ..Header::default() };
        let reason = peernet_sample::printable_line(reason).into_owned();
        let goodbye = MessageInfo {
            header,
            kind: MessageInfo::GOODBYE,
            request: MessageInfo::NO_REQUEST,
            reason: reason.clone(),
            ..MessageInfo::default()
        };
        let encoded = goodbye.encode(self.node.form()).map_err(|error| NodeFailure(error.to_string()));
        if let Err(error) = encoded.and_then(|message| self.refusals.publish(message)) {
            tracing::debug!(%error, topic = self.refusals.topic(), "an edge is not told why it gets no connection");
        }
        if is_new {
            let node = self.node.describe(&edge.node);
            let pipeline = peernet_sample::printable_line(&hello.pipeline);
            let text = format!(
                "refused a connection to {node} on {} for pipeline {pipeline}: {reason}",
                edge.remote.ip()
            );
            let refused = Arrival::Refused(hello.host.parse().ok(), text.clone());
            if self.deliveries.try_send((refused, Vec::new())).is_err() {
                tracing::warn!("{text}");
            }
        }
    }

    /// Why an edge gets no connection now.
    fn reason_to_refuse(
        &self,
        table: &Table,
        hello: &SessionHello,
        group: AddressGroup,
    ) -> Option<&'static str> {
        if let Some(earlier) = table.entries.get(&hello.pipeline) {
            // A host is believed that it has come back only from where it was.
            let is_same = earlier.host == hello.host && earlier.group == group;
            return (!is_same).then_some(
                "another host uses the topics of this pipeline, and keeps them until its connection has ended; give one of \
                 the pipelines another name, or set ROS_NAMESPACE to a namespace of each robot",
            );
        }
        let unadmitted =
            table.entries.values().filter(|entry| *entry.standing.borrow() != Standing::Admitted);
        let (mut all, mut of_group) = (0, 0);
        for entry in unadmitted {
            all += 1;
            of_group += usize::from(entry.group == group);
        }
        let most_unadmitted = (self.max_connections / 2)
            .min(MAX_ALL_UNADMITTED_BYTES / (MAX_UNADMITTED_BYTES * MAX_UNADMITTED_MESSAGES));
        if table.entries.len() >= self.max_connections {
            Some("there are too many; raise the limit of open files (LimitNOFILE)")
        } else if all >= most_unadmitted.max(1) || of_group >= (most_unadmitted / 2).max(1) {
            Some("too many others have no session yet")
        } else {
            None
        }
    }

    /// Removes a connection that has ended, unless another has its topics already.
    fn forget(&self, pipeline: &str, entry: &Arc<Entry>) {
        let mut table = self.table();
        if table.entries.get(pipeline).is_some_and(|current| Arc::ptr_eq(current, entry)) {
            table.entries.remove(pipeline);
        }
    }

    async fn serve(
        self: &Arc<Self>,
        entry: &Arc<Entry>,
        pipeline: &str,
        edge: &RemoteNode,
    ) -> Result<(), NodeFailure> {
        let (request, response) = (TopicPair::request(pipeline), TopicPair::response(pipeline));
        let kind = (TopicUse::Companions, TopicType::of::<MessageInfo>());
        let publisher = self.node.publish(&response.info, kind.clone(), queue_limits(&self.settings)).await?;
        // Of its own, so that nobody without a session takes memory from sessions, or from others without one.
        let budget = MemoryBudget::new((MAX_UNADMITTED_BYTES * MAX_UNADMITTED_MESSAGES) as u64);
        let unadmitted =
            ReceiveLimits { max_message_bytes: MAX_UNADMITTED_BYTES, budget: Arc::clone(&budget) };
        let options = unadmitted.subscriber_options(&self.settings, &edge.node);
        let info = self.node.subscribe(&request.info, kind, options).await?;
        let shared = (Arc::clone(&self.node), SharedClock::clone(&self.clock));
        let sending = (publisher, response.payload);
        let channel = Arc::new(Channel::new(shared, entry.id.clone(), &self.settings, budget, sending));
        channel.set_peer(edge.clone());
        *entry.channel() = Some(Arc::clone(&channel));
        let sink = CloudSink {
            peers: Arc::clone(self),
            peer: Peer { connection: entry.connection, address: Some(edge.remote) },
            standing: entry.standing.subscribe(),
            deadline: Some(Instant::now() + self.settings.hello_timeout()),
            unadmitted,
            node: Arc::clone(&edge.node),
            payload_topic: request.payload,
            subscribing: None,
        };
        let serving = Serving {
            channel,
            info,
            payload: None,
            sink,
            deliveries: self.deliveries.clone(),
            stop: self.stop.clone(),
            abort: entry.abort.clone(),
        };
        serving.run("the cloud shuts down").await;
        Ok(())
    }
}

/// The cloud's side of one connection.
struct CloudSink {
    peers: Arc<Peers>,
    peer: Peer,
    standing: watch::Receiver<Standing>,
    /// When the connection ends if it has no session.
    deadline: Option<Instant>,
    /// Without a session.
    unadmitted: ReceiveLimits,
    /// The edge's node.
    node: Arc<str>,
    payload_topic: String,
    /// The payload topic, once a session was accepted.
    subscribing: Option<AbortOnDropHandle<Box<dyn SessionSubscriber>>>,
}

impl Sink for CloudSink {
    type Delivery = Delivery;

    fn take(&mut self, channel: &Channel, event: Event) -> Option<Delivery> {
        let connection = self.peer.connection;
        let (arrival, reserved) = match event {
            Event::Hello => {
                channel.announce(MessageInfo::WELCOME);
                return None;
            }
            Event::Welcome => return None,
            Event::Message(frames, reserved) => (Arrival::Message(self.peer.clone(), frames), reserved),
            Event::Incomplete(loss) => (Arrival::Incomplete(connection, loss), Vec::new()),
            Event::Lost(loss) => (Arrival::Lost(connection, loss), Vec::new()),
            Event::Garbage(problem) => (Arrival::Garbage(self.address(), problem), Vec::new()),
            Event::Remark(text) => (Arrival::Remark(connection, text), Vec::new()),
            Event::Gone(reason) => (Arrival::Gone(connection, reason), Vec::new()),
        };
        Some((arrival, reserved))
    }

    async fn wait(&mut self, channel: &Arc<Channel>) -> Directive {
        let deadline = self.deadline;
        let too_late = async move {
            match deadline {
                Some(deadline) => sleep_until(deadline).await,
                None => std::future::pending().await,
            }
        };
        let subscribed = async {
            match &mut self.subscribing {
                Some(subscribing) => subscribing.await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            result = subscribed => {
                self.subscribing = None;
                match result {
                    Ok(subscriber) => Directive::Admit(subscriber),
                    Err(error) => Directive::End(error.to_string()),
                }
            }
            changed = self.standing.changed() => {
                let standing = *self.standing.borrow_and_update();
                match changed {
                    Ok(()) => self.follow(standing, channel),
                    Err(_) => Directive::End("the connection was closed here".to_owned()),
                }
            }
            () = too_late => Directive::End("no session was opened in time".to_owned()),
        }
    }
}

impl CloudSink {
    fn address(&self) -> Option<SocketAddr> {
        self.peer.address
    }

    fn follow(&mut self, standing: Standing, channel: &Arc<Channel>) -> Directive {
        let settings = &self.peers.settings;
        self.deadline = (standing == Standing::Unadmitted).then(|| Instant::now() + settings.hello_timeout());
        if standing != Standing::Admitted {
            return Directive::Limit(self.unadmitted.clone());
        }
        let budget = Arc::clone(&self.peers.budget);
        let admitted = ReceiveLimits { max_message_bytes: largest_message(settings), budget };
        if !self.payload_topic.is_empty() {
            let topic = std::mem::take(&mut self.payload_topic);
            let node = Arc::clone(&self.peers.node);
            let options = admitted.subscriber_options(settings, &self.node);
            // It asks the master, which may be away; what arrives meanwhile is in the companions.
            let channel = Arc::clone(channel);
            let subscribing = tokio::spawn(async move { subscribe(&*node, &topic, options, &channel).await });
            self.subscribing = Some(AbortOnDropHandle::new(subscribing));
        }
        Directive::Limit(admitted)
    }
}

/// Subscribes to a payload topic, again and again while the master is away.
async fn subscribe(
    node: &dyn SessionNode,
    topic: &str,
    options: SubscriberOptions,
    channel: &Channel,
) -> Box<dyn SessionSubscriber> {
    let mut is_told = false;
    loop {
        match node.subscribe(topic, (TopicUse::Payloads, TopicType::any()), options.clone()).await {
            Ok(subscriber) => return subscriber,
            Err(error) if !is_told => {
                channel.remark(&mut channel.lock(), payload_topic_closed(topic, &error));
                is_told = true;
            }
            Err(_) => {}
        }
        sleep(MASTER_RETRY).await;
    }
}
