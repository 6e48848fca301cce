//! One end of a virtual connection on topics: its state machine and its publishers.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock};
use peernet_ros::messages::{EncodedMessage, Message, MessageInfo};
use peernet_ros::ros1::Delivery;
use peernet_sample::Description;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep};

use super::connection::Connection;
use super::connection_clock::ConnectionClock;
use super::fragments;
use super::frames::{self, PAYLOAD_FRAME};
use super::interface::{NodeFailure, RemoteNode, SessionNode, SessionPublisher};
use super::limits::{INFO_OVERHEAD_BYTES, connection_limits, queue_limits};
use super::payload::PayloadType;
use super::payload_topic::{MASTER_RETRY_INTERVAL, Payload, PayloadTopic, describe_open_failure};
use crate::SessionSettings;
use crate::message::{Header, Outcome};
use crate::statistics::{ConnectionAddresses, DatagramStatistics, TransportStatistics};
use crate::transport::memory::MemoryBudget;
use crate::transport::tcp_info::tcp_statistics;
use crate::transport::{SendFailure, SendOptions};

/// One end of a connection, shared by senders and the connection's task.
#[derive(Debug)]
pub(super) struct Channel {
    pub(super) node: Arc<dyn SessionNode>,
    clock: ConnectionClock,
    state: Mutex<Connection>,
    /// Publisher of companions.
    companion_publisher: Box<dyn SessionPublisher>,
    payload_topic: PayloadTopic,
    /// Signals that a remark for the layer above is queued.
    has_remark: Notify,
    /// Node and connection of the other end, once they are known.
    peer: OnceLock<RemoteNode>,
}

/// Description of a message's first payload part and time of the message's departure, from the message's header.
struct PayloadHeader {
    part: Description,
    /// Nanoseconds since the Unix epoch.
    departure: i64,
}

impl Channel {
    pub(super) fn new(
        (node, clock): (Arc<dyn SessionNode>, SharedClock),
        id: String,
        settings: &SessionSettings,
        budget: Arc<MemoryBudget>,
        (companion_publisher, payload_topic): (Box<dyn SessionPublisher>, String),
    ) -> Self {
        // The clock of a connection starts at zero.
        let connection =
            Connection::new(id, connection_limits(settings, &*node), budget, MonoTime::default());
        Self {
            node,
            clock: ConnectionClock::start(clock),
            state: Mutex::new(connection),
            companion_publisher,
            payload_topic: PayloadTopic::new(payload_topic, queue_limits(settings)),
            has_remark: Notify::new(),
            peer: OnceLock::new(),
        }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Connection> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the current time for the state machine.
    pub(super) fn now(&self) -> MonoTime {
        self.clock.now()
    }

    /// Returns the instant of the state machine's next timer.
    pub(super) fn next_timer(&self) -> Option<Instant> {
        self.lock().next_timer().map(|next| self.clock.instant(next))
    }

    /// Returns the node at the other end. Messages of other nodes are ignored.
    pub(super) fn peer(&self) -> Option<&RemoteNode> {
        self.peer.get()
    }

    /// Sets the node at the other end. Only the first call has an effect.
    pub(super) fn set_peer(&self, peer: RemoteNode) {
        self.peer.get_or_init(|| peer);
    }

    /// Publishes a companion without frames for all subscribers. `kind` is a constant of [`MessageInfo`].
    pub(super) fn announce(&self, kind: u8) {
        let companion = self.new_companion(kind);
        let is_greeting = matches!(kind, MessageInfo::HELLO | MessageInfo::WELCOME);
        // The frame lengths of a hello and a welcome contain the size of this end's receive buffer, because the other
        // end has no other way to know this size.
        let buffer = self.node.receive_buffer_bytes().filter(|_| is_greeting);
        let frame_lengths =
            buffer.map(|bytes| u32::try_from(bytes).unwrap_or(u32::MAX)).into_iter().collect();
        self.publish_for_all(&MessageInfo { frame_lengths, ..companion });
    }

    /// Publishes a goodbye.
    pub(super) fn send_goodbye(&self, reason: &str) {
        let companion = self.new_companion(MessageInfo::GOODBYE);
        self.publish_for_all(&MessageInfo { reason: reason.to_owned(), ..companion });
    }

    fn new_companion(&self, kind: u8) -> MessageInfo {
        self.lock().new_companion(kind, self.clock.wall(), self.now())
    }

    /// Publishes a companion to all subscribers. A failure is only logged.
    fn publish_for_all(&self, companion: &MessageInfo) {
        let encoded = companion.encode(self.node.form()).map_err(|error| NodeFailure(error.to_string()));
        if let Err(error) = encoded.and_then(|message| self.companion_publisher.publish(message)) {
            tracing::debug!(
                topic = self.companion_publisher.topic(),
                %error,
                "cannot publish a message about the state of a connection"
            );
        }
    }

    /// Publishes heartbeats and notices that are due.
    pub(super) fn send_notices(&self) {
        loop {
            let notice = self.lock().next_notice(self.clock.wall(), self.now());
            match notice {
                Some(notice) => self.publish_for_all(&notice),
                None => return,
            }
        }
    }

    /// Publishes a message. Its first payload part is published on the payload topic if the part has the type of the
    /// topic and the topic is open. Everything else is published on the companions' topic.
    pub(super) fn send(&self, message: &[Bytes], options: SendOptions) -> Result<(), SendFailure> {
        let gone_failure = |reason: String| SendFailure::Gone(reason);
        let peer = self.peer.get().ok_or_else(|| gone_failure("the connection is not open".into()))?;
        let payload_header = message.get(PAYLOAD_FRAME).and_then(|_| read_payload_header(message.first()?));
        let departure = payload_header.as_ref().map_or_else(|| self.clock.wall(), |header| header.departure);
        // The lock is held until both messages are published, so that both topics have the messages in the order of
        // their stamps.
        let mut state = self.lock();
        if state.is_closed() {
            return Err(gone_failure("the connection is closed".into()));
        }
        let mut companion = state.new_data_companion(departure);
        companion.request = options.tag.unwrap_or(MessageInfo::NO_REQUEST);
        let first_number = companion.sequence;
        let sent = self.send_companion(&mut state, companion, (message, payload_header), peer);
        match sent {
            // The peer would count the numbers of companions that were never sent as lost.
            Err(SendFailure::Full) => state.take_back_numbers(first_number),
            Ok(()) | Err(SendFailure::Gone(_)) => state.note_sent(self.now()),
        }
        sent
    }

    /// Publishes a message whose companion has no frames yet.
    fn send_companion(
        &self,
        state: &mut Connection,
        mut companion: MessageInfo,
        (message, payload_header): (&[Bytes], Option<PayloadHeader>),
        peer: &RemoteNode,
    ) -> Result<(), SendFailure> {
        let gone_failure = |reason: String| SendFailure::Gone(reason);
        let has_payload = match (&payload_header, message.get(PAYLOAD_FRAME)) {
            (Some(payload_header), Some(data)) => {
                // Otherwise each attempt to send the message would publish the payload again.
                let frame_bytes = message.iter().map(Bytes::len).sum::<usize>() - data.len();
                if self.companion_publisher.is_full(&peer.node, frame_bytes + INFO_OVERHEAD_BYTES) {
                    return Err(SendFailure::Full);
                }
                let payload = Payload { header: &companion.header, part: &payload_header.part, data };
                self.publish_payload(state, &payload, peer)?
            }
            _ => false,
        };
        if !frames::pack(&mut companion, message, has_payload) {
            return Err(gone_failure("a frame has 4 GiB or more".into()));
        }
        // Each fragment takes the companion's current number, and the companion gets the next number: the companion is
        // sent after its fragments, and numbers are in the order of sending.
        let mut companions = Vec::new();
        for frames in fragments::split_into_fragments(&mut companion.frames, self.node.max_companion_bytes())
        {
            companions.push(MessageInfo { frames, ..state.new_fragment(&mut companion) });
        }
        companions.push(companion);
        let encoded = companions.iter().map(|companion| companion.encode(self.node.form()));
        let encoded: Vec<EncodedMessage> =
            encoded.collect::<Result<_, _>>().map_err(|error| gone_failure(error.to_string()))?;
        match self
            .companion_publisher
            .publish_fragments(&peer.node, &encoded)
            .map_err(|error| gone_failure(error.to_string()))?
        {
            Delivery::Accepted => Ok(()),
            Delivery::Full => Err(SendFailure::Full),
            Delivery::NotConnected => Err(gone_failure(format!(
                "node {} has left topic {}",
                peer.node,
                self.companion_publisher.topic()
            ))),
        }
    }

    /// Publishes the first payload part on the payload topic. Returns whether the peer receives this topic.
    fn publish_payload(
        &self,
        state: &mut Connection,
        payload: &Payload<'_>,
        peer: &RemoteNode,
    ) -> Result<bool, SendFailure> {
        let peer_and_state = (&*peer.node, state.peer());
        let mut remark = |text| self.remark(state, text);
        self.payload_topic.publish(&*self.node, peer_and_state, payload, &mut remark)
    }

    /// Queues a remark: a warning about the connection for the layer above. The connection's task hands it on.
    pub(super) fn remark(&self, state: &mut Connection, text: String) {
        state.remark(text);
        self.has_remark.notify_one();
    }

    /// Waits until a remark is queued.
    pub(super) async fn wait_for_remark(&self) {
        self.has_remark.notified().await;
    }

    /// Waits until the payload topic must be opened, which happens once. Returns the type of the topic.
    pub(super) async fn wait_for_payload_type(&self) -> PayloadType {
        self.payload_topic.take_request().await
    }

    /// Opens the payload topic. Repeats the attempt until it succeeds or the connection is closed.
    pub(super) async fn open_payload_topic(&self, kind: PayloadType) {
        let mut is_reported = false;
        while !self.lock().is_closed() {
            match self.payload_topic.open(&*self.node, kind).await {
                Ok(()) => return,
                Err(error) if !is_reported => {
                    let text = describe_open_failure(self.payload_topic.name(), &error);
                    self.remark(&mut self.lock(), text);
                    is_reported = true;
                }
                Err(_) => {}
            }
            sleep(MASTER_RETRY_INTERVAL).await;
        }
    }

    /// Returns the addresses of both ends of the path on which the peer's companions arrive. `None` before the peer is
    /// known.
    pub(super) fn addresses(&self) -> Option<ConnectionAddresses> {
        let peer = self.peer.get()?;
        Some(ConnectionAddresses { local: peer.local, remote: peer.remote })
    }

    /// Returns the statistics of the transport. The round trip is measured on the TCP connection on which the peer's
    /// companions arrive.
    pub(super) fn statistics(&self) -> TransportStatistics {
        let round_trip = self.addresses().and_then(|addresses| tcp_statistics(&addresses).round_trip);
        let lost = Some(self.lock().missing_companions());
        let received = DatagramStatistics { lost, ..DatagramStatistics::default() };
        TransportStatistics { sent: DatagramStatistics::default(), received, round_trip }
    }
}

/// Reads the first payload part and the departure from a message's header.
fn read_payload_header(header: &Bytes) -> Option<PayloadHeader> {
    let (departure, sample) = match Header::decode(header).ok()? {
        Header::Request(request) => (Some(request.departure), request.sample),
        Header::Reply(reply) => match reply.outcome {
            Outcome::Answer(sample) => (reply.departure, sample),
            _ => return None,
        },
        _ => return None,
    };
    let part = sample.parts.into_iter().next()?;
    Some(PayloadHeader { part, departure: departure?.sent.unix_nanos() })
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use peernet_clock::{ClockIdentity, ManualClock, WallTime};
    use peernet_sample::MediaType;

    use super::*;
    use crate::message::{Departure, Request, SampleHeader, SessionId};
    use crate::transport::ros::interface::test_node::TestNode;

    /// Returns a channel with a peer. `companions` publishes the companions, and `node` publishes all else.
    fn new_channel(node: &TestNode, companions: &TestNode) -> Channel {
        let identity = ClockIdentity::new("boot", "system");
        let clock: SharedClock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), identity));
        let channel = Channel::new(
            (Arc::new(node.clone()), clock),
            "ab".into(),
            &SessionSettings::default(),
            MemoryBudget::new(1_000),
            (Box::new(companions.clone()), "/line/request".into()),
        );
        let address = SocketAddr::from(([192, 0, 2, 1], 1));
        channel.set_peer(RemoteNode { node: "/cloud".into(), local: address, remote: address });
        channel
    }

    #[test]
    fn message_that_the_queue_refuses_takes_no_number_and_replaces_no_heartbeat() {
        let node = TestNode::default();
        let channel = new_channel(&node, &node);
        let send = || channel.send(&[Bytes::from_static(b"header")], SendOptions::default());
        send().expect("the queue is empty");
        let next_heartbeat = channel.lock().next_timer();
        node.set_full(true);
        for _ in 0..3 {
            let refused = send();
            assert!(matches!(refused, Err(SendFailure::Full)), "{refused:?}");
        }
        assert_eq!(channel.lock().next_timer(), next_heartbeat, "a refused message replaces no heartbeat");
        node.set_full(false);
        send().expect("the queue has space again");
        let next = channel.lock().new_companion(MessageInfo::HEARTBEAT, 0, MonoTime::default());
        assert_eq!(next.sequence, 2, "the peer counts a gap in the numbers as lost messages");
    }

    #[tokio::test]
    async fn payload_is_not_published_while_queue_of_companions_is_full() {
        let (node, companions) = (TestNode::default(), TestNode::default());
        let channel = new_channel(&node, &companions);
        let departure = Departure {
            sent: WallTime::default(),
            sent_since_anchor: Default::default(),
            epoch: 0,
            sent_raw: None,
        };
        let parts = vec![Description::unshaped(MediaType::Jpeg)];
        let sample = SampleHeader { parts, source: String::new(), label: None };
        let request = Request { session: SessionId::random(), request: 1, departure, sample };
        let header = Header::Request(request).encode().expect("is short");
        let message = [header, Bytes::from_static(b"tree"), Bytes::from_static(b"jpg")];
        let send = || channel.send(&message, SendOptions::default());
        // The first payload opens the topic.
        send().expect("the queue is empty");
        let payload_type = channel.wait_for_payload_type().await;
        channel.open_payload_topic(payload_type).await;
        companions.set_full(true);
        for _ in 0..3 {
            let refused = send();
            assert!(matches!(refused, Err(SendFailure::Full)), "{refused:?}");
        }
        assert_eq!(node.published_count(), 0, "the message was refused, so its payload is not published");
        companions.set_full(false);
        send().expect("the queue has space again");
        assert_eq!((node.published_count(), companions.published_count()), (1, 2));
    }
}
