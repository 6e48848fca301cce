//! Publisher that keeps the order of messages and never waits.
//!
//! `rustdds` sends a message as fast as it can, and slowly retransmits what does not fit into a receive buffer. The
//! number of unacknowledged bytes is therefore limited. Further messages wait in a queue for a task.
//!
//! A reliable subscription that does not keep up must not stop the other subscriptions. `rustdds` stores up to 1,024
//! messages that such a subscription has not acknowledged, and then refuses further messages. If other programs
//! subscribe as well, the task waits at most 50 ms for acknowledgments. The topic ends if a message waits for 5 s, or
//! if 256 MiB are unacknowledged; the edge then opens another session. Messages that only a viewer misses do not matter
//! to the session. A viewer with
//! *keep last*, the default in ROS 2, acknowledges what arrives, whether or not its program reads it.

use std::collections::VecDeque;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::SharedClock;
use peernet_ros::messages::EncodedMessage;
use peernet_ros::ros1::Delivery;
use peernet_ros::ros2::{EndpointId, Ros2Error, Ros2Publisher};
use tokio::sync::Notify;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::publishing_tasks::PublishingTasks;
use crate::transport::ros::interface::{NodeFailure, SessionPublisher};

/// Time limit for acknowledgments while other programs, which may be slow, subscribe as well.
const SHARED_TOPIC_TIMEOUT: Duration = Duration::from_millis(50);

/// Longest time for which a message may wait because earlier messages are not acknowledged.
const MAX_UNACKNOWLEDGED_TIME: Duration = Duration::from_secs(5);

/// Maximum number of bytes that are stored for subscriptions that do not acknowledge them.
const MAX_UNACKNOWLEDGED_BYTES: usize = 256 * 1024 * 1024;

/// A publisher and its queue.
pub(super) struct Ros2SessionPublisher {
    state: Arc<PublisherState>,
}

struct PublisherState {
    publisher: Ros2Publisher,
    topic: String,
    clock: SharedClock,
    queue: Mutex<Queue>,
    /// Signals that a message was queued, or that the queue was closed.
    queue_changed: Notify,
}

#[derive(Default)]
struct Queue {
    messages: VecDeque<Bytes>,
    /// Bytes of the queued messages and of the message that waits to be published.
    bytes: usize,
    max_bytes: usize,
    /// `true` while the task waits to publish the oldest message.
    is_busy: bool,
    /// Bytes published since the last time at which everything was acknowledged.
    unacknowledged_bytes: usize,
    is_closed: bool,
    failure: Option<NodeFailure>,
}

impl Ros2SessionPublisher {
    pub(super) fn new(
        publisher: Ros2Publisher,
        max_bytes: usize,
        clock: SharedClock,
        tasks: &PublishingTasks,
    ) -> Self {
        let queue = Mutex::new(Queue { max_bytes, ..Queue::default() });
        let topic = publisher.topic().to_owned();
        let state = Arc::new(PublisherState { publisher, topic, clock, queue, queue_changed: Notify::new() });
        let task_state = Arc::clone(&state);
        tasks.spawn(|stop| task_state.run(stop));
        Self { state }
    }

    /// Publishes messages, or queues them for the task.
    fn offer(&self, messages: &[EncodedMessage]) -> Result<Delivery, NodeFailure> {
        let state = &*self.state;
        let mut queue = state.queue();
        if let Some(failure) = &queue.failure {
            return Err(failure.clone());
        }
        let bytes: usize = messages.iter().map(EncodedMessage::len).sum();
        if queue.is_full(bytes) {
            return Ok(Delivery::Full);
        }
        for message in messages {
            let message = message.clone().into_bytes();
            // A message is published at once if nothing is queued, because a switch to another task would take time.
            if queue.messages.is_empty() && !queue.is_busy && state.publish(&mut queue, &message)? {
                continue;
            }
            queue.bytes += message.len();
            queue.messages.push_back(message);
            state.queue_changed.notify_one();
        }
        Ok(Delivery::Accepted)
    }
}

impl Queue {
    /// Returns whether the queue is too full for messages of `bytes` bytes. One message alone always fits.
    fn is_full(&self, bytes: usize) -> bool {
        let is_empty = self.messages.is_empty() && !self.is_busy;
        !is_empty && self.bytes.saturating_add(bytes) > self.max_bytes
    }
}

impl PublisherState {
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Publishes a message if `rustdds` accepts the message now. Returns whether the message was published.
    fn publish(&self, queue: &mut Queue, message: &Bytes) -> Result<bool, Ros2Error> {
        let is_published = self.publisher.try_publish(message.clone(), self.clock.wall())?.is_some();
        if is_published {
            queue.unacknowledged_bytes += message.len();
        }
        Ok(is_published)
    }

    /// Publishes the queued messages. Ends when the queue is closed and everything is acknowledged.
    async fn run(self: Arc<Self>, stop: CancellationToken) {
        loop {
            let changed = self.queue_changed.notified();
            // `Ok` has the next message. `Err` means that no message is queued, and says whether the queue is closed.
            let next_message = {
                let mut queue = self.queue();
                let next_message = queue.messages.pop_front();
                queue.is_busy = next_message.is_some();
                match next_message {
                    Some(next_message) => Ok(next_message),
                    None => Err(queue.is_closed),
                }
            };
            match next_message {
                Ok(message) => {
                    if let Err(failure) = self.publish_when_accepted(&message).await {
                        tracing::warn!(topic = self.topic, %failure, "stopped publishing a ROS 2 topic");
                        let mut queue = self.queue();
                        *queue = Queue { failure: Some(failure), ..Queue::default() };
                        return;
                    }
                    self.queue().bytes -= message.len();
                }
                Err(true) => break,
                Err(false) => {
                    // The task ends only while the queue is empty, so that all queued messages are sent first.
                    if stop.run_until_cancelled(changed).await.is_none() {
                        break;
                    }
                }
            }
        }
        if let Err(error) = self.publisher.wait_for_acknowledgment(MAX_UNACKNOWLEDGED_TIME).await {
            tracing::debug!(topic = self.topic, %error, "a ROS 2 topic ended before all messages were acknowledged");
        }
    }

    /// Publishes a message as soon as `rustdds` accepts it.
    async fn publish_when_accepted(&self, message: &Bytes) -> Result<(), NodeFailure> {
        let started_at = Instant::now();
        loop {
            if self.publish(&mut self.queue(), message)? {
                return Ok(());
            }
            let subscription_count = self.publisher.peers().borrow().matched.len();
            let ack_timeout =
                if subscription_count > 1 { SHARED_TOPIC_TIMEOUT } else { MAX_UNACKNOWLEDGED_TIME };
            match self.publisher.wait_for_acknowledgment(ack_timeout).await {
                Ok(()) => self.queue().unacknowledged_bytes = 0,
                // `rustdds` keeps the messages that another program has not acknowledged. They do not count in the
                // limit of `publisher` any more, so that they do not stop the other subscriptions. The queue's
                // `unacknowledged_bytes` still counts them.
                Err(Ros2Error::Unacknowledged { .. }) => self.publisher.forget_unacknowledged(),
                Err(error) => return Err(error.into()),
            }
            let unacknowledged = self.queue().unacknowledged_bytes;
            if started_at.elapsed() >= MAX_UNACKNOWLEDGED_TIME || unacknowledged > MAX_UNACKNOWLEDGED_BYTES {
                return Err(NodeFailure(format!(
                    "{subscription_count} subscriptions of topic {} do not acknowledge what was published ({unacknowledged} bytes); stop programs that \
                     only watch the topic and do not keep up, or raise net.core.rmem_max on their hosts",
                    self.topic
                )));
            }
        }
    }
}

fn is_endpoint_of(id: EndpointId, node: &str) -> bool {
    id.participant().to_string() == node
}

impl fmt::Debug for Ros2SessionPublisher {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Ros2SessionPublisher").field("topic", &self.state.topic).finish()
    }
}

impl Drop for Ros2SessionPublisher {
    fn drop(&mut self) {
        self.state.queue().is_closed = true;
        self.state.queue_changed.notify_one();
    }
}

impl SessionPublisher for Ros2SessionPublisher {
    fn topic(&self) -> &str {
        &self.state.topic
    }

    fn publish(&self, message: EncodedMessage) -> Result<(), NodeFailure> {
        match self.offer(&[message])? {
            Delivery::Full => Err(NodeFailure("the queue is full".to_owned())),
            _ => Ok(()),
        }
    }

    // The result is never `NotConnected`: DDS does not report whether the other end has found this publisher. A payload
    // is sent on its topic alone only after a companion of the other end has confirmed the topic. The end of a node is
    // noticed by the end of that node's own topics.
    fn publish_fragments(&self, _node: &str, fragments: &[EncodedMessage]) -> Result<Delivery, NodeFailure> {
        self.offer(fragments)
    }

    fn is_full(&self, _node: &str, length: usize) -> bool {
        self.state.queue().is_full(length)
    }

    fn describe_mismatch(&self, node: &str) -> Option<String> {
        let peers = self.state.publisher.peers();
        let peers = peers.borrow();
        let (_, mismatch) = peers.refused.iter().find(|(id, _)| is_endpoint_of(**id, node))?;
        Some(format!(
            "the other end does not receive topic {}: {mismatch}; give both ends the same keys in session.ros2",
            self.state.topic
        ))
    }
}
