//! Blocking readers of topics.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{SharedClock, WallTime};
use tokio::time::timeout;

use super::nodes::{SharedNode, open_on_ros1, ros2_node, runtime};
use super::topic_check::list_topics;
use super::{MessageType, RosVersion, TopicError};
use crate::messages::WireForm;
use crate::ros1::{
    self, Environment, Node, NodeError, PublisherState, PublisherStatus, QueueLimits, Subscriber,
    SubscriberOptions, TopicType, WhenFull,
};
use crate::ros2::{QosProfile, Reliability, Ros2Node, Ros2Subscription};

/// Options of a reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReaderOptions {
    /// Maximum number of messages that wait to be read. If more messages arrive, the oldest message is dropped and
    /// counted, because a robot needs the newest message.
    pub queue: u32,
    /// Reliability in ROS 2. A reliable reader gets no messages of a best-effort publisher.
    pub reliability: Reliability,
}

/// A message of a topic.
#[derive(Clone, Debug)]
pub struct TopicMessage {
    /// Serialization of `bytes`.
    pub form: WireForm,
    /// Type of the message, as its publisher announces it in ROS 1, or as the reader requested it in ROS 2.
    pub type_name: Arc<str>,
    /// Bytes of the message.
    pub bytes: Bytes,
    /// Time at which this host had received the whole message, by its wall clock.
    pub received: WallTime,
    /// Number of messages that came after the previously read message and were not read. Newer messages replaced them
    /// in the queue or, in ROS 2, they were lost or had an unsupported encoding.
    pub dropped: u64,
}

/// Receives the messages of a topic from all its publishers. Its methods block.
pub struct TopicReader {
    inner: VersionedSubscriber,
    /// Number of messages that earlier calls have reported as dropped, without the lost messages of ROS 2.
    reported_drops: u64,
}

/// The fields are dropped in order: the subscriber before its node, which then informs the master.
enum VersionedSubscriber {
    Ros1 {
        subscriber: Subscriber,
        environment: Environment,
        #[expect(dead_code, reason = "keeps the node")]
        node: Arc<SharedNode>,
    },
    Ros2 {
        subscription: Box<Ros2Subscription>,
        type_name: Arc<str>,
        #[expect(dead_code, reason = "keeps the node")]
        node: Arc<Ros2Node>,
    },
}

impl TopicReader {
    /// Subscribes to a topic. `message_type` is the type of its messages. Without a type, a reader of ROS 1 accepts
    /// every type. Blocks until the subscription is registered.
    ///
    /// # Errors
    /// If the environment or the name cannot be used, no master answers, the type is missing in ROS 2, or this build
    /// has no ROS 2.
    pub fn open(
        version: RosVersion,
        topic: &str,
        message_type: Option<&MessageType>,
        options: ReaderOptions,
        clock: &SharedClock,
    ) -> Result<Self, TopicError> {
        let inner = runtime()?.block_on(async {
            match version {
                RosVersion::Ros1 => open_ros1(topic, message_type, options, clock).await,
                RosVersion::Ros2 => open_ros2(topic, message_type, options).await,
            }
        })?;
        Ok(Self { inner, reported_drops: 0 })
    }

    /// Waits for the next message. Blocks.
    ///
    /// # Errors
    /// If no message arrives within `time_limit`: [`TopicError::NoMessage`], or [`NoPeer`](crate::ros2::NoPeer) in ROS
    /// 2, with the state of the publishers. Another error if the node has ended ([`TopicError::needs_reopening`]).
    pub fn read(&mut self, time_limit: Duration) -> Result<TopicMessage, TopicError> {
        runtime()?.block_on(self.read_within(time_limit))
    }

    async fn read_within(&mut self, time_limit: Duration) -> Result<TopicMessage, TopicError> {
        match &mut self.inner {
            VersionedSubscriber::Ros1 { subscriber, environment, .. } => {
                let Ok(message) = timeout(time_limit, subscriber.recv()).await else {
                    let reason = describe_missing_message(subscriber, environment).await;
                    let topic = subscriber.topic().to_owned();
                    return Err(TopicError::NoMessage { topic, time_limit, reason });
                };
                let message = message?;
                // The counts are totals; the message reports the increase since the last message.
                let dropped = subscriber.counts().dropped;
                Ok(TopicMessage {
                    form: WireForm::Ros1,
                    type_name: Arc::clone(&message.publisher.kind.name),
                    bytes: message.bytes,
                    received: message.received.wall,
                    dropped: dropped - std::mem::replace(&mut self.reported_drops, dropped),
                })
            }
            VersionedSubscriber::Ros2 { subscription, type_name, .. } => {
                let Ok(sample) = timeout(time_limit, subscription.receive()).await else {
                    // If there is no publisher, the error says what discovery has seen.
                    subscription.wait_for_peer(Duration::ZERO).await?;
                    let reason = "its publishers are connected, but publish nothing".to_owned();
                    let topic = subscription.topic().to_owned();
                    return Err(TopicError::NoMessage { topic, time_limit, reason });
                };
                let sample = sample?;
                let undecodable = subscription.counts().undecodable;
                let newly_undecodable =
                    undecodable - std::mem::replace(&mut self.reported_drops, undecodable);
                Ok(TopicMessage {
                    form: WireForm::Cdr,
                    type_name: Arc::clone(type_name),
                    bytes: sample.payload,
                    received: sample.received_time,
                    dropped: sample.missing_before.saturating_add(newly_undecodable),
                })
            }
        }
    }
}

async fn open_ros1(
    topic: &str,
    message_type: Option<&MessageType>,
    options: ReaderOptions,
    clock: &SharedClock,
) -> Result<VersionedSubscriber, TopicError> {
    let environment = Environment::from_process()?;
    // The MD5 sum is a wildcard, because the sums of types that this program does not decode are unknown.
    let kind = match message_type {
        Some(message_type) => TopicType { name: message_type.as_str().into(), ..TopicType::any() },
        None => TopicType::any(),
    };
    let messages = usize::try_from(options.queue).unwrap_or(usize::MAX);
    let options = SubscriberOptions {
        queue: QueueLimits { messages, ..QueueLimits::default() },
        when_full: WhenFull::DropOldest,
        ..SubscriberOptions::default()
    };
    let subscribe = async |node: &Node| node.subscribe(topic, kind.clone(), options.clone()).await;
    let (subscriber, node) = open_on_ros1(&environment, clock, subscribe).await?;
    Ok(VersionedSubscriber::Ros1 { subscriber, environment, node })
}

async fn open_ros2(
    topic: &str,
    message_type: Option<&MessageType>,
    options: ReaderOptions,
) -> Result<VersionedSubscriber, TopicError> {
    let message_type = message_type.ok_or_else(|| TopicError::TypeRequired { topic: topic.to_owned() })?;
    let qos = QosProfile { reliability: options.reliability, depth: options.queue, ..QosProfile::default() };
    let node = ros2_node().await?;
    let subscription = node.create_subscription(topic, message_type.as_str(), &qos)?;
    Ok(VersionedSubscriber::Ros2 {
        subscription: Box::new(subscription),
        type_name: message_type.as_str().into(),
        node,
    })
}

/// Returns the reason why no message arrives, according to the connections to publishers and the master.
async fn describe_missing_message(subscriber: &Subscriber, environment: &Environment) -> String {
    let publishers = subscriber.publishers();
    let failures = publishers.iter().filter_map(|publisher| match &publisher.state {
        PublisherState::Failed(reason) => Some(reason.clone()),
        PublisherState::Connecting | PublisherState::Connected(_) => None,
    });
    if let Some(reason) = failures.into_iter().next() {
        return reason;
    }
    match &publishers[..] {
        [] => match ros1::topic_types(environment).await {
            // The master also lists the topic of this subscriber, because the subscriber is registered.
            Ok(topics) => format!(
                "no node publishes it; check its name; the ROS master at {}: {}",
                environment.master,
                list_topics(
                    topics.iter().map(|(name, _)| name.as_str()).filter(|name| *name != subscriber.topic())
                )
            ),
            Err(error @ NodeError::NoMaster { .. }) => error.to_string(),
            Err(error) => format!(
                "no publisher of it is known, and the ROS master did not answer which topics exist: {error}"
            ),
        },
        publishers => describe_silent_publishers(publishers),
    }
}

/// Returns the reason why no message arrives from publishers whose connections have not failed.
fn describe_silent_publishers(publishers: &[PublisherStatus]) -> String {
    let is_connected = |status: &&PublisherStatus| matches!(status.state, PublisherState::Connected(_));
    let connected = publishers.iter().filter(is_connected).count();
    match (publishers, connected) {
        ([publisher], 0) => {
            format!("its publisher at {} has not answered the request for a connection yet", publisher.uri)
        }
        ([publisher], _) => format!("its publisher at {} is connected, but publishes nothing", publisher.uri),
        (publishers, connected) if connected == publishers.len() => {
            format!("its {connected} publishers are connected, but publish nothing")
        }
        (publishers, connected) => format!(
            "{connected} of its {} publishers are connected, but publish nothing; the others have not answered the request for a \
             connection yet",
            publishers.len()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros1::{PublisherInfo, ReceiveCounts};

    #[test]
    fn publisher_without_answer_is_not_called_connected() {
        let with_state = |state| PublisherStatus {
            uri: "http://robot:1/".into(),
            state,
            counts: ReceiveCounts::default(),
            rejected_node: None,
        };
        let address = "127.0.0.1:1".parse().expect("an address");
        let info = PublisherInfo {
            node: "/camera".into(),
            uri: "http://robot:1/".into(),
            kind: TopicType::any(),
            local: address,
            remote: address,
        };
        let connected = with_state(PublisherState::Connected(Arc::new(info)));
        let connecting = with_state(PublisherState::Connecting);
        for (publishers, expected) in [
            (vec![connecting.clone()], "at http://robot:1/ has not answered"),
            (vec![connected.clone()], "at http://robot:1/ is connected"),
            (vec![connected.clone(), connected.clone()], "its 2 publishers are connected"),
            (vec![connected, connecting], "1 of its 2 publishers are connected"),
        ] {
            let text = describe_silent_publishers(&publishers);
            assert!(text.contains(expected), "{text}");
        }
    }
}
