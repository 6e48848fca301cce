//! One end of a virtual connection on topics: its state machine, and what it publishes.

use std::any::Any;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_ros::messages::{EncodedMessage, Message, MessageInfo};
use peernet_ros::ros1::{Delivery, MemoryLimit, QueueLimits, SubscriberOptions, WhenFull};
use peernet_sample::Description;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep};

use super::connection::{Connection, ConnectionLimits};
use super::frames::{self, PAYLOAD_FRAME};
use super::interface::{NodeFailure, RemoteNode, SessionNode, SessionPublisher, TopicUse};
use super::parts;
use super::payload::{self, PayloadType};
use crate::SessionSettings;
use crate::message::{Header, Outcome};
use crate::statistics::{ConnectionAddresses, DatagramStatistics, TransportStatistics};
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::tcp_info::tcp_statistics;
use crate::transport::{SendFailure, SendOptions};

/// Longest wait for the other half of a message: both may be under way on a slow link.
const PAIRING_TIMEOUT: Span = Span::from_seconds(30);

/// Time between two attempts to open a topic while the master is away.
pub(super) const MASTER_RETRY: Duration = Duration::from_secs(1);

/// Bytes of the messages on a topic that wait to be taken, unless it is a single longer one.
const WAITING_BYTES: usize = 64 * 1024;

/// Bytes of a companion beside its frames.
pub(super) const INFO_OVERHEAD_BYTES: usize = 4 * 1024;

/// Bounds of a connection.
pub(super) fn connection_limits(settings: &SessionSettings, node: &dyn SessionNode) -> ConnectionLimits {
    ConnectionLimits {
        max_message_bytes: settings.max_message_bytes,
        max_incomplete: settings.max_in_flight as usize + 16,
        confirms_payloads: node.receive_buffer_bytes().is_some(),
        pairing_timeout: node.payload_patience().map_or(PAIRING_TIMEOUT, Span::from),
        heartbeat_interval: settings.heartbeat_interval().into(),
        heartbeat_timeout: settings.heartbeat_timeout().into(),
    }
}

/// Bytes of the longest message on a topic.
pub(super) fn largest_message(settings: &SessionSettings) -> usize {
    usize::try_from(settings.max_message_bytes).unwrap_or(usize::MAX).saturating_add(INFO_OVERHEAD_BYTES)
}

/// What the peer may send.
#[derive(Clone, Debug)]
pub(super) struct ReceiveLimits {
    /// Longest message on a topic. Bytes.
    pub(super) max_message_bytes: usize,
    /// Shared by all that is received, from its first bytes until it is handed up.
    pub(super) budget: Arc<MemoryBudget>,
}

impl ReceiveLimits {
    /// Bounds of what a topic that is subscribed to holds before it is taken: more stays with the publisher.
    pub(super) fn subscriber_options(
        &self,
        settings: &SessionSettings,
        publisher: &Arc<str>,
    ) -> SubscriberOptions {
        SubscriberOptions {
            queue: QueueLimits { messages: queue_limits(settings).messages, bytes: WAITING_BYTES },
            when_full: WhenFull::Wait,
            max_message_bytes: self.max_message_bytes,
            publisher: Some(Arc::clone(publisher)),
            memory: self.memory(),
        }
    }

    /// The budget, for the client of ROS.
    pub(super) fn memory(&self) -> Option<Arc<dyn MemoryLimit>> {
        Some(Arc::new(ReceivingMemory(Arc::clone(&self.budget))))
    }
}

/// A budget as the client of ROS asks it.
#[derive(Debug)]
struct ReceivingMemory(Arc<MemoryBudget>);

impl MemoryLimit for ReceivingMemory {
    fn reserve(&self, bytes: usize) -> Option<Box<dyn Any + Send + Sync>> {
        let mut reserved = Reservation::empty(&self.0);
        reserved.set(&self.0, bytes as u64).ok()?;
        Some(Box::new(reserved))
    }
}

/// Bounds of the queue of a topic that is published: every request in flight has a place, and what opens, keeps and closes a
/// connection.
pub(super) fn queue_limits(settings: &SessionSettings) -> QueueLimits {
    QueueLimits { messages: settings.max_in_flight as usize + 32, bytes: largest_message(settings) }
}

/// One end of a connection, as senders and its task share it.
#[derive(Debug)]
pub(super) struct Channel {
    pub(super) node: Arc<dyn SessionNode>,
    pub(super) clock: SharedClock,
    start: Instant,
    state: Mutex<Connection>,
    info: Box<dyn SessionPublisher>,
    queue: QueueLimits,
    payload_topic: String,
    /// Set when the first message with a payload was sent; what travels before the topic is there stays in the companion.
    payload: OnceLock<(PayloadType, Box<dyn SessionPublisher>)>,
    /// The type that the payload topic is to have.
    pub(super) wanted: OnceLock<PayloadType>,
    /// The task has something to do.
    pub(super) wake: Notify,
    /// The node at the other end, once it is known, and the connection from it.
    peer: OnceLock<RemoteNode>,
    /// Set when it has been said that the other end's QoS does not fit.
    refusal: OnceLock<()>,
    /// Set when it has been said that payloads are too long for the payload topic.
    size_remark: OnceLock<()>,
}

/// What a message says of its first payload part and of its departure.
struct Described {
    part: Description,
    departure: i64,
}

impl Channel {
    pub(super) fn new(
        (node, clock): (Arc<dyn SessionNode>, SharedClock),
        id: String,
        settings: &SessionSettings,
        budget: Arc<MemoryBudget>,
        (info, payload_topic): (Box<dyn SessionPublisher>, String),
    ) -> Self {
        let connection =
            Connection::new(id, connection_limits(settings, &*node), budget, MonoTime::default());
        Self {
            node,
            clock,
            start: Instant::now(),
            state: Mutex::new(connection),
            info,
            queue: queue_limits(settings),
            payload_topic,
            payload: OnceLock::new(),
            wanted: OnceLock::new(),
            wake: Notify::new(),
            peer: OnceLock::new(),
            refusal: OnceLock::new(),
            size_remark: OnceLock::new(),
        }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Connection> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The time of the state machine.
    pub(super) fn now(&self) -> MonoTime {
        MonoTime::default() + Span::from(self.start.elapsed())
    }

    /// The moment of a time of the state machine.
    pub(super) fn instant(&self, time: MonoTime) -> Instant {
        self.start + (time - MonoTime::default()).to_duration()
    }

    /// The node at the other end; messages of others are not taken.
    pub(super) fn peer(&self) -> Option<&RemoteNode> {
        self.peer.get()
    }

    /// Sets the node at the other end; the first one stays.
    pub(super) fn set_peer(&self, peer: RemoteNode) {
        self.peer.get_or_init(|| peer);
    }

    /// Publishes a companion without frames, for whoever subscribes.
    pub(super) fn announce(&self, kind: u8) {
        let info = self.lock().begin(kind, self.clock.wall().unix_nanos(), self.now());
        let tells_buffer = matches!(kind, MessageInfo::HELLO | MessageInfo::WELCOME);
        let buffer = self.node.receive_buffer_bytes().filter(|_| tells_buffer);
        let frame_lengths =
            buffer.map(|bytes| u32::try_from(bytes).unwrap_or(u32::MAX)).into_iter().collect();
        self.publish_for_all(&MessageInfo { frame_lengths, ..info });
    }

    /// Says goodbye.
    pub(super) fn say_goodbye(&self, reason: &str) {
        let info = self.lock().begin(MessageInfo::GOODBYE, self.clock.wall().unix_nanos(), self.now());
        self.publish_for_all(&MessageInfo { reason: reason.to_owned(), ..info });
    }

    fn publish_for_all(&self, info: &MessageInfo) {
        let published = info.encode(self.node.form()).map_err(|error| NodeFailure(error.to_string()));
        if let Err(error) = published.and_then(|message| self.info.publish(message)) {
            tracing::debug!(
                topic = self.info.topic(),
                %error,
                "a message about a connection was not published"
            );
        }
    }

    /// Sends heartbeats and notices that are due.
    pub(super) fn send_notices(&self) {
        loop {
            let notice = self.lock().next_notice(self.clock.wall().unix_nanos(), self.now());
            match notice {
                Some(notice) => self.publish_for_all(&notice),
                None => return,
            }
        }
    }

    /// Publishes a message: its first payload part on the payload topic where that fits and is there, all else on the
    /// companions' topic.
    pub(super) fn send(&self, message: &[Bytes], options: SendOptions) -> Result<(), SendFailure> {
        let gone = |reason: String| SendFailure::Gone(reason);
        let peer = self.peer.get().ok_or_else(|| gone("the connection is not open".into()))?;
        let described = message.get(PAYLOAD_FRAME).and_then(|_| describe(message.first()?));
        let wall = self.clock.wall().unix_nanos();
        let departure = described.as_ref().map_or(wall, |described| described.departure);
        // Held until both are published, so that both topics have the messages in the order of their stamps.
        let mut state = self.lock();
        if state.is_closed() {
            return Err(gone("the connection is closed".into()));
        }
        let mut info = state.begin(MessageInfo::DATA, departure, self.now());
        info.request = options.tag.unwrap_or(MessageInfo::NO_REQUEST);
        let has_payload = match (&described, message.get(PAYLOAD_FRAME)) {
            (Some(described), Some(data)) => {
                self.publish_payload(&info, &mut state, (&described.part, data), &peer.node)?
            }
            _ => false,
        };
        if !frames::pack(&mut info, message, has_payload) {
            return Err(gone("a frame has 4 GiB or more".into()));
        }
        let mut companions = Vec::new();
        for frames in parts::split(&mut info.frames, self.node.max_companion_bytes()) {
            companions.push(MessageInfo { frames, ..state.begin_part(&mut info) });
        }
        companions.push(info);
        let encoded = companions.iter().map(|companion| companion.encode(self.node.form()));
        let encoded: Vec<EncodedMessage> =
            encoded.collect::<Result<_, _>>().map_err(|error| gone(error.to_string()))?;
        match self.info.publish_to(&peer.node, &encoded).map_err(|error| gone(error.to_string()))? {
            Delivery::Taken => Ok(()),
            Delivery::Full => Err(SendFailure::Full),
            Delivery::Absent => Err(gone(format!("node {} has left topic {}", peer.node, self.info.topic()))),
        }
    }

    /// Publishes the first payload part. Returns whether the peer gets it this way.
    fn publish_payload(
        &self,
        info: &MessageInfo,
        state: &mut Connection,
        (part, data): (&Description, &Bytes),
        peer: &str,
    ) -> Result<bool, SendFailure> {
        let kind = PayloadType::of(part, data.len());
        let Some((published, publisher)) = self.payload.get() else {
            if self.wanted.set(kind).is_ok() {
                self.wake.notify_one();
            }
            return Ok(false);
        };
        if *published != kind || !self.holds_payload(state, data.len(), publisher.topic()) {
            return Ok(false);
        }
        let is_confirmed = self.node.receive_buffer_bytes().is_none() || state.peer().is_subscribed;
        if !is_confirmed
            && let Some(reason) = publisher.refusal(peer)
            && self.refusal.set(()).is_ok()
        {
            self.remark(state, format!("payloads travel in their companions as well: {reason}"));
        }
        // A value that this version of ROS cannot say travels in the companion.
        let Ok(message) = payload::encode(self.node.form(), &info.header, part, data) else {
            return Ok(false);
        };
        match publisher.publish_to(peer, &[message]) {
            Ok(Delivery::Taken) => Ok(is_confirmed),
            Ok(Delivery::Full) if is_confirmed => Err(SendFailure::Full),
            Ok(Delivery::Full | Delivery::Absent) => Ok(false),
            Err(error) => Err(SendFailure::Gone(error.to_string())),
        }
    }

    /// Whether the sockets of both ends hold a payload of a number of bytes.
    fn holds_payload(&self, state: &mut Connection, bytes: usize, topic: &str) -> bool {
        let Some(own) = self.node.receive_buffer_bytes() else { return true };
        let most = state.peer().receive_buffer_bytes.map_or(own, |theirs| own.min(theirs as usize));
        if bytes > most && self.size_remark.set(()).is_ok() {
            let text = format!(
                "a payload of {bytes} bytes is longer than the {most} bytes that the sockets of both hosts hold: such payloads travel \
                 in parts and not on topic {topic}, where other programs would see them; raise socket_buffer_bytes of the session, and \
                 net.core.rmem_max, on both hosts"
            );
            self.remark(state, text);
        }
        bytes <= most
    }

    /// Has the task hand up what makes the connection worse than it could be.
    pub(super) fn remark(&self, state: &mut Connection, text: String) {
        state.remark(text);
        self.wake.notify_one();
    }

    /// Opens the payload topic, again and again while the master is away.
    pub(super) async fn publish_payload_topic(&self, kind: PayloadType) {
        let (topic, mut is_told) = (&*self.payload_topic, false);
        while !self.lock().is_closed() {
            match self.node.publish(topic, (TopicUse::Payloads, kind.topic_type()), self.queue).await {
                Ok(publisher) => {
                    self.payload.get_or_init(|| (kind, publisher));
                    return;
                }
                Err(error) if !is_told => {
                    self.remark(&mut self.lock(), payload_topic_closed(topic, &error));
                    is_told = true;
                }
                Err(_) => {}
            }
            sleep(MASTER_RETRY).await;
        }
    }

    /// Both ends of the connection on which the peer's companions arrive.
    pub(super) fn addresses(&self) -> Option<ConnectionAddresses> {
        let peer = self.peer.get()?;
        Some(ConnectionAddresses { local: peer.local, remote: peer.remote })
    }

    /// What is known beside whole messages. The round trip is that of the connection of the peer's companions.
    pub(super) fn statistics(&self) -> TransportStatistics {
        let round_trip = self.addresses().and_then(|addresses| tcp_statistics(&addresses).round_trip);
        let lost = Some(self.lock().missed());
        let received = DatagramStatistics { lost, ..DatagramStatistics::default() };
        TransportStatistics { sent: DatagramStatistics::default(), received, round_trip }
    }
}

/// Says that a payload topic could not be opened, for a remark.
pub(super) fn payload_topic_closed(topic: &str, error: &NodeFailure) -> String {
    format!(
        "topic {topic} could not be opened, and is tried again every {} s; payloads travel on the topic of their companions \
         until then: {error}",
        MASTER_RETRY.as_secs()
    )
}

/// Reads what a message's header says of the first payload part.
fn describe(header: &Bytes) -> Option<Described> {
    let (departure, sample) = match Header::decode(header).ok()? {
        Header::Request(request) => (Some(request.departure), request.sample),
        Header::Reply(reply) => match reply.outcome {
            Outcome::Answer(sample) => (reply.departure, sample),
            _ => return None,
        },
        _ => return None,
    };
    let part = sample.parts.into_iter().next()?;
    Some(Described { part, departure: departure?.sent.unix_nanos() })
}
