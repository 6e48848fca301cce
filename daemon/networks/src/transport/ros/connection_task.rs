//! The task of one end of a virtual connection: receives from its topics and runs its timers.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use peernet_ros::messages::{Message, MessageInfo};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

use super::channel::Channel;
use super::connection::Event;
use super::interface::{NodeFailure, PublisherChanges, SessionSubscriber, TopicMessage};
use super::limits::ReceiveLimits;
use super::payload;
use super::second_publishers::SecondPublishers;
use crate::transport::CLOSED_HERE;

/// Receiver of the events of a connection.
pub(super) trait Sink: Send {
    /// Form in which events are handed to the layer above.
    type Delivery: Send;

    /// Handles an event. Returns the delivery for the layer above, if there is one.
    fn handle_event(&mut self, channel: &Channel, event: Event) -> Option<Self::Delivery>;

    /// Waits for the next directive of this end.
    fn next_directive(&mut self, channel: &Arc<Channel>) -> impl Future<Output = Directive> + Send;
}

/// Request of an edge or a cloud to the task of its connection.
pub(super) enum Directive {
    /// Receive payloads from this subscriber.
    ReceivePayloads(Box<dyn SessionSubscriber>),
    /// Use these limits for companions.
    SetLimits(ReceiveLimits),
    /// End the connection for this reason.
    End(String),
}

/// The task of one end of a connection.
pub(super) struct ConnectionTask<S: Sink> {
    pub(super) channel: Arc<Channel>,
    /// Subscriber of the peer's companions.
    pub(super) companion_subscriber: Box<dyn SessionSubscriber>,
    /// Subscriber of the peer's payloads, once it exists.
    pub(super) payload_subscriber: Option<Box<dyn SessionSubscriber>>,
    pub(super) sink: S,
    pub(super) deliveries: mpsc::Sender<S::Delivery>,
    /// Token that ends the connection with a goodbye.
    pub(super) stop: CancellationToken,
    /// Token that ends the connection without a goodbye.
    pub(super) abort: CancellationToken,
}

/// Next event that the task handles.
enum Step {
    /// A companion arrived, or its subscription ended.
    Companion(Result<TopicMessage, NodeFailure>),
    /// A payload arrived, or its subscription ended.
    Payload(Result<TopicMessage, NodeFailure>),
    Directive(Directive),
    /// The publishers of a topic have changed.
    Publishers,
    /// Nothing beyond what every iteration of the loop does.
    Other,
}

impl<S: Sink> ConnectionTask<S> {
    /// Runs until the connection has ended and all events were handed to the layer above.
    pub(super) async fn run(self, goodbye: &str) {
        let channel = Arc::clone(&self.channel);
        self.run_until_end(goodbye).await;
        // Senders may still hold the channel. A message to a closed connection is an error.
        channel.lock().end(CLOSED_HERE.to_owned());
    }

    async fn run_until_end(mut self, goodbye: &str) {
        let mut queued_deliveries = VecDeque::new();
        let mut second_publishers = SecondPublishers::default();
        let mut connected_topics = BTreeSet::new();
        let mut is_closing = false;
        let mut left_topic = None;
        loop {
            self.send_due();
            self.remark_newly_named_publishers(&mut second_publishers);
            self.collect_events(&mut queued_deliveries);
            while !queued_deliveries.is_empty()
                && let Ok(permit) = self.deliveries.try_reserve()
                && let Some(delivery) = queued_deliveries.pop_front()
            {
                permit.send(delivery);
            }
            if self.channel.lock().is_closed() && queued_deliveries.is_empty() {
                if self.peer_awaits_goodbye() && !is_closing {
                    // The other end has ended the connection itself, so it needs no reason.
                    self.channel.send_goodbye("");
                }
                return;
            }
            // The views of the publishers and the future of their changes are created before the publishers are
            // checked, so that no change in between is missed.
            let companion_publishers = self.companion_subscriber.watch();
            let payload_publishers = self.payload_subscriber.as_ref().map(|payload| payload.watch());
            let publisher_change =
                wait_for_publisher_change(&*companion_publishers, payload_publishers.as_deref());
            // After the peer has left a topic, the connection ends at the deadline at the latest, even if the peer
            // returns to the topic: messages may have been lost in between.
            left_topic = left_topic.or_else(|| {
                self.disconnected_topic(&mut connected_topics)
                    .map(|topic| (topic, Instant::now() + LEAVE_TIMEOUT))
            });
            if let Some((topic, deadline)) = &left_topic
                && !self.channel.lock().is_closed()
            {
                // Messages that the peer published before it left may still be queued here, possibly with its goodbye.
                while let Some(message) = self.companion_subscriber.try_recv() {
                    self.handle_step(Step::Companion(Ok(message)), &mut second_publishers);
                }
                while let Some(message) =
                    self.payload_subscriber.as_mut().and_then(|payload| payload.try_recv())
                {
                    self.handle_step(Step::Payload(Ok(message)), &mut second_publishers);
                }
                let peer = self.channel.peer().map_or("", |peer| &peer.node).to_owned();
                if !self.has_connected_topic() || Instant::now() >= *deadline {
                    self.channel.lock().end(format!("node {peer} has left topic {topic}"));
                    continue;
                }
            }
            let next_timer = self
                .channel
                .next_timer()
                .into_iter()
                .chain(left_topic.as_ref().map(|(_, deadline)| *deadline))
                .min();
            let can_receive = queued_deliveries.is_empty();
            // A closed connection only hands its last events over. Its deadlines have passed and would end every wait
            // at once.
            let is_closed = self.channel.lock().is_closed();
            let Self { channel, companion_subscriber, payload_subscriber, sink, deliveries, stop, abort } =
                &mut self;
            let step = tokio::select! {
                biased;
                () = abort.cancelled() => {
                    // In ROS 2, the topics and nodes do not show the other end that this connection has ended, because
                    // a later connection may use the same topics and nodes.
                    if channel.node.is_connectionless() {
                        channel.send_goodbye("the other end ended the connection without waiting");
                    }
                    return;
                }
                () = stop.cancelled(), if !is_closing && !is_closed => {
                    channel.send_goodbye(goodbye);
                    // In ROS 2, topics may end without their last messages. The other end's goodbye confirms that all
                    // messages have arrived.
                    if !channel.node.is_connectionless() || channel.peer().is_none() {
                        return;
                    }
                    is_closing = true;
                    Step::Other
                }
                permit = deliveries.reserve(), if !can_receive => {
                    match permit {
                        Ok(permit) => if let Some(delivery) = queued_deliveries.pop_front() {
                            permit.send(delivery);
                        },
                        // Nothing receives the events any more.
                        Err(_) => queued_deliveries.clear(),
                    }
                    Step::Other
                }
                // Messages that are not taken stay in the topic's queue. When the queue is full, they stay with the
                // publisher.
                message = companion_subscriber.recv(), if can_receive => Step::Companion(message),
                message = receive(payload_subscriber), if can_receive => Step::Payload(message),
                directive = sink.next_directive(channel), if !is_closed => Step::Directive(directive),
                () = channel.wait_for_remark() => Step::Other,
                kind = channel.wait_for_payload_type() => {
                    let channel = Arc::clone(channel);
                    tokio::spawn(async move { channel.open_payload_topic(kind).await });
                    Step::Other
                }
                () = publisher_change => Step::Publishers,
                () = sleep_until(next_timer.unwrap_or_else(Instant::now)), if next_timer.is_some() && !is_closed => {
                    Step::Other
                }
            };
            self.handle_step(step, &mut second_publishers);
        }
    }

    fn handle_step(&mut self, step: Step, second_publishers: &mut SecondPublishers) {
        match step {
            Step::Companion(Ok(message)) => {
                if self.is_of_peer(&message, self.companion_subscriber.topic(), second_publishers) {
                    self.receive_companion(message);
                }
            }
            Step::Payload(Ok(message)) => {
                // A payload arrives only through the payload subscriber, so the companion topic is never used.
                let topic = self
                    .payload_subscriber
                    .as_ref()
                    .map_or_else(|| self.companion_subscriber.topic(), |payload| payload.topic());
                if self.is_of_peer(&message, topic, second_publishers) {
                    self.receive_payload(message);
                }
            }
            Step::Companion(Err(error)) | Step::Payload(Err(error)) => {
                self.channel.lock().end(error.to_string());
            }
            Step::Directive(Directive::ReceivePayloads(payload)) => self.payload_subscriber = Some(payload),
            Step::Directive(Directive::SetLimits(limits)) => {
                self.companion_subscriber.set_message_limits(limits.max_message_bytes, limits.memory());
                self.channel.lock().set_budget(limits.budget);
            }
            Step::Directive(Directive::End(reason)) => self.channel.lock().end(reason),
            Step::Publishers => {
                for subscriber in
                    [Some(&self.companion_subscriber), self.payload_subscriber.as_ref()].into_iter().flatten()
                {
                    for node in subscriber.rejected_publishers() {
                        self.remark_second_publisher(&node, subscriber.topic(), second_publishers);
                    }
                }
            }
            Step::Other => {}
        }
    }

    /// Returns whether the other end has said goodbye and waits for the goodbye of this end.
    fn peer_awaits_goodbye(&self) -> bool {
        self.channel.node.is_connectionless() && self.channel.lock().peer().has_left
    }

    /// Returns whether the peer still publishes one of the topics. Its last messages may then still be in transfer.
    fn has_connected_topic(&self) -> bool {
        let topics = [Some(&self.companion_subscriber), self.payload_subscriber.as_ref()];
        topics.into_iter().flatten().any(|subscriber| is_connected(&**subscriber, &self.channel))
    }

    /// Returns a topic that the peer published until now and does not publish any more. `connected_topics` has the
    /// topics that the peer published, and is updated.
    fn disconnected_topic(&self, connected_topics: &mut BTreeSet<String>) -> Option<String> {
        // In ROS 2 the payload topic does not count, because its publisher may belong to an earlier connection that
        // ends.
        let is_connectionless = self.channel.node.is_connectionless();
        let topics = [
            Some(&self.companion_subscriber),
            self.payload_subscriber.as_ref().filter(|_| !is_connectionless),
        ];
        topics.into_iter().flatten().find_map(|subscriber| {
            let topic = subscriber.topic();
            if !is_connected(&**subscriber, &self.channel) {
                // Before the peer's first companion, the publisher that left may belong to an earlier connection of
                // the same pipeline, which this connection replaces.
                if !self.channel.lock().has_received() {
                    connected_topics.remove(topic);
                }
                return connected_topics.contains(topic).then(|| topic.to_owned());
            }
            if !connected_topics.contains(topic) {
                connected_topics.insert(topic.to_owned());
            }
            None
        })
    }

    /// Returns whether a message is from the node at the other end. If not, adds a remark on the node that sent the
    /// message, once for each node.
    fn is_of_peer(
        &self,
        message: &TopicMessage,
        topic: &str,
        second_publishers: &mut SecondPublishers,
    ) -> bool {
        // The peer is always known here: the task starts after the peer was set.
        let Some(peer) = self.channel.peer() else { return true };
        let node = &message.publisher.node;
        if peer.node == *node {
            return true;
        }
        self.remark_second_publisher(node, topic, second_publishers);
        false
    }

    fn remark_second_publisher(
        &self,
        node: &Arc<str>,
        topic: &str,
        second_publishers: &mut SecondPublishers,
    ) {
        let Some(peer) = self.channel.peer() else { return };
        if let Some(remark) =
            second_publishers.check(node, topic, (&peer.node, &*self.channel.node), Instant::now())
        {
            self.channel.lock().remark(remark);
        }
    }

    /// Adds the remarks on publishers whose names were unknown when they were found.
    fn remark_newly_named_publishers(&self, second_publishers: &mut SecondPublishers) {
        let Some(peer) = self.channel.peer() else { return };
        for remark in second_publishers.check_unnamed((&peer.node, &*self.channel.node), Instant::now()) {
            self.channel.lock().remark(remark);
        }
    }

    /// Handles a companion.
    // The memory of the message is released first, because the connection reserves memory for the same bytes.
    fn receive_companion(&self, TopicMessage { bytes, memory, .. }: TopicMessage) {
        drop(memory);
        let now = self.channel.now();
        let mut state = self.channel.lock();
        match MessageInfo::decode(self.channel.node.form(), bytes) {
            // The companion belongs to an earlier or later connection between the same nodes.
            Ok(info) if info.header.frame_id != state.id() => {}
            Ok(info) => state.receive_companion(info, now),
            Err(error) => state.report_invalid(format!("cannot decode a companion: {error}")),
        }
    }

    fn receive_payload(&self, TopicMessage { bytes, memory, type_name, .. }: TopicMessage) {
        drop(memory);
        let decoded = payload::decode(self.channel.node.form(), &type_name, bytes);
        let now = self.channel.now();
        let mut state = self.channel.lock();
        match decoded {
            Ok((connection, _, _)) if connection != state.id() => {}
            Ok((_, stamp, payload)) => state.receive_payload(stamp, payload, now),
            Err(error) => state.report_invalid(format!("cannot decode a payload: {error}")),
        }
    }

    /// Runs the timers of the connection, and publishes the messages that are due.
    fn send_due(&self) {
        let now = self.channel.now();
        self.channel.lock().tick(now);
        self.channel.send_notices();
    }

    fn collect_events(&mut self, queued_deliveries: &mut VecDeque<S::Delivery>) {
        loop {
            // This is a separate statement, so that the lock is released before the event is handled.
            let event = self.channel.lock().next_event();
            let Some(event) = event else { return };
            queued_deliveries.extend(self.sink.handle_event(&self.channel, event));
        }
    }
}

/// Time for which the last messages of a peer are awaited after the peer has left one of the two topics. Messages of
/// the two topics have no common order.
const LEAVE_TIMEOUT: Duration = Duration::from_millis(500);

async fn receive(subscriber: &mut Option<Box<dyn SessionSubscriber>>) -> Result<TopicMessage, NodeFailure> {
    match subscriber {
        Some(subscriber) => subscriber.recv().await,
        None => std::future::pending().await,
    }
}

/// Waits until the publishers of one of the two topics have changed after this call.
fn wait_for_publisher_change<'a>(
    companion: &'a dyn PublisherChanges,
    payload: Option<&'a dyn PublisherChanges>,
) -> impl Future<Output = ()> + 'a {
    let (companion, payload) = (companion.changed(), payload.map(PublisherChanges::changed));
    async move {
        match payload {
            Some(payload) => tokio::select! {
                () = companion => {}
                () = payload => {}
            },
            None => companion.await,
        }
    }
}

/// Returns whether the peer publishes the topic of this subscriber.
fn is_connected(subscriber: &dyn SessionSubscriber, channel: &Channel) -> bool {
    channel.peer().is_some_and(|peer| subscriber.is_connected(&peer.node))
}
