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

/// Receiver of the events of a connection.
pub(super) trait Sink: Send {
    /// Form in which events are handed up.
    type Delivery: Send;

    /// Handles an event. Returns what is handed up, if anything is.
    fn handle_event(&mut self, channel: &Channel, event: Event) -> Option<Self::Delivery>;

    /// Waits for the next directive of this end.
    fn next_directive(&mut self, channel: &Arc<Channel>) -> impl Future<Output = Directive> + Send;
}

/// Request of an edge or a cloud to the task of its connection.
pub(super) enum Directive {
    /// Receive payloads from this subscriber.
    Admit(Box<dyn SessionSubscriber>),
    /// Use these limits for companions.
    Limit(ReceiveLimits),
    /// End the connection for this reason.
    End(String),
}

/// The task of one end of a connection.
pub(super) struct ConnectionTask<S: Sink> {
    pub(super) channel: Arc<Channel>,
    pub(super) info: Box<dyn SessionSubscriber>,
    pub(super) payload: Option<Box<dyn SessionSubscriber>>,
    pub(super) sink: S,
    pub(super) deliveries: mpsc::Sender<S::Delivery>,
    /// Token that ends the connection with a goodbye.
    pub(super) stop: CancellationToken,
    /// Token that ends the connection without a goodbye.
    pub(super) abort: CancellationToken,
}

enum Step {
    Info(Result<TopicMessage, NodeFailure>),
    Payload(Result<TopicMessage, NodeFailure>),
    Directive(Directive),
    /// The publishers of a topic have changed.
    Publishers,
    Other,
}

impl<S: Sink> ConnectionTask<S> {
    /// Runs until the connection has ended and all events were handed up.
    pub(super) async fn run(self, goodbye: &str) {
        let channel = Arc::clone(&self.channel);
        self.run_until_end(goodbye).await;
        channel.lock().end("the connection was closed here".to_owned());
    }

    async fn run_until_end(mut self, goodbye: &str) {
        let mut queued = VecDeque::new();
        let mut others = SecondPublishers::default();
        let mut connected = BTreeSet::new();
        let mut is_closing = false;
        let mut departure = None;
        loop {
            self.send_due();
            self.remark_named_publishers(&mut others);
            self.collect_events(&mut queued);
            while !queued.is_empty()
                && let Ok(permit) = self.deliveries.try_reserve()
                && let Some(delivery) = queued.pop_front()
            {
                permit.send(delivery);
            }
            if self.channel.lock().is_closed() && queued.is_empty() {
                if self.answers_goodbye() && !is_closing {
                    self.channel.send_goodbye("");
                }
                return;
            }
            // Created before the publishers are checked, so that no change in between is missed.
            let info_publishers = self.info.watch();
            let payload_publishers = self.payload.as_ref().map(|payload| payload.watch());
            let publisher_change =
                wait_for_publisher_change(&*info_publishers, payload_publishers.as_deref());
            // Not reset if the peer returns to the topic, because messages may have been lost in between.
            departure = departure.or_else(|| {
                self.disconnected_topic(&mut connected).map(|topic| (topic, Instant::now() + LEAVE_TIMEOUT))
            });
            if let Some((topic, until)) = &departure
                && !self.channel.lock().is_closed()
            {
                // Messages that the peer published before it left may still be queued here, possibly with its goodbye.
                while let Some(message) = self.info.try_recv() {
                    self.handle_step(Step::Info(Ok(message)), &mut others);
                }
                while let Some(message) = self.payload.as_mut().and_then(|payload| payload.try_recv()) {
                    self.handle_step(Step::Payload(Ok(message)), &mut others);
                }
                let peer = self.channel.peer().map_or("", |peer| &peer.node).to_owned();
                if !self.has_connected_topic() || Instant::now() >= *until {
                    self.channel.lock().end(format!("node {peer} has left topic {topic}"));
                    continue;
                }
            }
            let next = self
                .channel
                .next_timer()
                .into_iter()
                .chain(departure.as_ref().map(|(_, until)| *until))
                .min();
            let is_idle = queued.is_empty();
            let Self { channel, info, payload, sink, deliveries, stop, abort } = &mut self;
            let step = tokio::select! {
                biased;
                () = abort.cancelled() => {
                    // The other end cannot notice the end by the topics and nodes, because a later connection may use the
                    // same ones.
                    if channel.node.receive_buffer_bytes().is_some() {
                        channel.send_goodbye("the other end ended the connection without waiting");
                    }
                    return;
                }
                () = stop.cancelled(), if !is_closing && !channel.lock().is_closed() => {
                    channel.send_goodbye(goodbye);
                    // In ROS 2, topics may end without their last messages. The other end's goodbye confirms that it
                    // has all of them.
                    if channel.node.receive_buffer_bytes().is_none() || channel.peer().is_none() {
                        return;
                    }
                    is_closing = true;
                    Step::Other
                }
                permit = deliveries.reserve(), if !is_idle => {
                    match permit {
                        Ok(permit) => if let Some(delivery) = queued.pop_front() {
                            permit.send(delivery);
                        },
                        // Nothing receives the events any more.
                        Err(_) => queued.clear(),
                    }
                    Step::Other
                }
                // Messages that are not taken stay in the topic's queue, and then with the publisher.
                message = info.recv(), if is_idle => Step::Info(message),
                message = receive(payload), if is_idle => Step::Payload(message),
                directive = sink.next_directive(channel) => Step::Directive(directive),
                () = channel.wait_for_remark() => Step::Other,
                kind = channel.wait_for_payload_type() => {
                    let channel = Arc::clone(channel);
                    tokio::spawn(async move { channel.publish_payload_topic(kind).await });
                    Step::Other
                }
                () = publisher_change => Step::Publishers,
                () = sleep_until(next.unwrap_or_else(Instant::now)), if next.is_some() => Step::Other,
            };
            self.handle_step(step, &mut others);
        }
    }

    fn handle_step(&mut self, step: Step, others: &mut SecondPublishers) {
        match step {
            Step::Info(Ok(message)) => {
                if self.is_of_peer(&message, self.info.topic(), others) {
                    self.receive_info(message);
                }
            }
            Step::Payload(Ok(message)) => {
                let topic =
                    self.payload.as_ref().map_or_else(|| self.info.topic(), |payload| payload.topic());
                if self.is_of_peer(&message, topic, others) {
                    self.receive_payload(message);
                }
            }
            Step::Info(Err(error)) | Step::Payload(Err(error)) => self.channel.lock().end(error.to_string()),
            Step::Directive(Directive::Admit(payload)) => self.payload = Some(payload),
            Step::Directive(Directive::Limit(limits)) => {
                self.info.set_message_limits(limits.max_message_bytes, limits.memory());
                self.channel.lock().set_budget(limits.budget);
            }
            Step::Directive(Directive::End(reason)) => self.channel.lock().end(reason),
            Step::Publishers => {
                for subscriber in [Some(&self.info), self.payload.as_ref()].into_iter().flatten() {
                    for node in subscriber.other_publishers() {
                        self.remark_second_publisher(&node, subscriber.topic(), others);
                    }
                }
            }
            Step::Other => {}
        }
    }

    /// Returns whether the other end waits for an answer to its goodbye.
    fn answers_goodbye(&self) -> bool {
        self.channel.node.receive_buffer_bytes().is_some() && self.channel.lock().peer().has_left
    }

    /// Returns whether the last messages of a leaving peer may still be in transfer.
    fn has_connected_topic(&self) -> bool {
        let topics = [Some(&self.info), self.payload.as_ref()];
        topics.into_iter().flatten().any(|subscriber| is_connected(&**subscriber, &self.channel))
    }

    /// Returns a topic on which messages of the peer arrived until now and do not arrive any more.
    fn disconnected_topic(&self, connected: &mut BTreeSet<String>) -> Option<String> {
        // Where payloads are confirmed, the publisher of the payload topic may belong to an earlier connection that ends.
        let is_confirmed = self.channel.node.receive_buffer_bytes().is_some();
        let topics = [Some(&self.info), self.payload.as_ref().filter(|_| !is_confirmed)];
        topics.into_iter().flatten().find_map(|subscriber| {
            let topic = subscriber.topic();
            if !is_connected(&**subscriber, &self.channel) {
                // Before the peer's first companion, the publisher that left may be that of an earlier connection of
                // the same pipeline, which this one replaces.
                if !self.channel.lock().has_received() {
                    connected.remove(topic);
                }
                return connected.contains(topic).then(|| topic.to_owned());
            }
            if !connected.contains(topic) {
                connected.insert(topic.to_owned());
            }
            None
        })
    }

    /// Returns whether a message is from the node at the other end. There is one remark on each other node.
    fn is_of_peer(&self, message: &TopicMessage, topic: &str, others: &mut SecondPublishers) -> bool {
        let Some(peer) = self.channel.peer() else { return true };
        let node = &message.publisher.node;
        if peer.node == *node {
            return true;
        }
        self.remark_second_publisher(node, topic, others);
        false
    }

    fn remark_second_publisher(&self, second: &Arc<str>, topic: &str, others: &mut SecondPublishers) {
        let Some(peer) = self.channel.peer() else { return };
        if let Some(remark) = others.check(second, topic, (&peer.node, &*self.channel.node), Instant::now()) {
            self.channel.lock().remark(remark);
        }
    }

    fn remark_named_publishers(&self, others: &mut SecondPublishers) {
        let Some(peer) = self.channel.peer() else { return };
        for remark in others.check_unnamed((&peer.node, &*self.channel.node), Instant::now()) {
            self.channel.lock().remark(remark);
        }
    }

    // The memory of the message is released first, because the connection reserves memory for the same bytes.
    fn receive_info(&self, TopicMessage { bytes, memory, .. }: TopicMessage) {
        drop(memory);
        let now = self.channel.now();
        let mut state = self.channel.lock();
        match MessageInfo::decode(self.channel.node.form(), bytes) {
            // The companion belongs to an earlier or later connection between the same nodes.
            Ok(info) if info.header.frame_id != state.id() => {}
            Ok(info) => state.receive_info(info, now),
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

    fn send_due(&self) {
        let now = self.channel.now();
        self.channel.lock().tick(now);
        self.channel.send_notices();
    }

    fn collect_events(&mut self, queued: &mut VecDeque<S::Delivery>) {
        loop {
            // A separate statement, so that the lock is released before the event is handled.
            let event = self.channel.lock().next_event();
            let Some(event) = event else { return };
            queued.extend(self.sink.handle_event(&self.channel, event));
        }
    }
}

/// Time for which the last messages of a peer are awaited after it has left one of the two topics, which have no common
/// order.
const LEAVE_TIMEOUT: Duration = Duration::from_millis(500);

async fn receive(subscriber: &mut Option<Box<dyn SessionSubscriber>>) -> Result<TopicMessage, NodeFailure> {
    match subscriber {
        Some(subscriber) => subscriber.recv().await,
        None => std::future::pending().await,
    }
}

/// Waits until the publishers of a topic have changed after this call.
fn wait_for_publisher_change<'a>(
    info: &'a dyn PublisherChanges,
    payload: Option<&'a dyn PublisherChanges>,
) -> impl Future<Output = ()> + 'a {
    let (info, payload) = (info.changed(), payload.map(PublisherChanges::changed));
    async move {
        match payload {
            Some(payload) => tokio::select! {
                () = info => {}
                () = payload => {}
            },
            None => info.await,
        }
    }
}

/// Returns whether the peer's messages arrive.
fn is_connected(subscriber: &dyn SessionSubscriber, channel: &Channel) -> bool {
    channel.peer().is_some_and(|peer| subscriber.is_connected(&peer.node))
}
