//! Blocking writers of topics.

use std::sync::Arc;

use peernet_clock::SharedClock;

use super::nodes::{SharedNode, open_on_ros1, ros2_node, runtime};
use super::{RosVersion, TopicError};
use crate::messages::{Message, WireForm};
use crate::ros1::{Environment, Publisher, PublisherOptions, TopicType};
use crate::ros2::{QosProfile, Ros2Node, Ros2Publisher};

/// Result of publishing a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteOutcome {
    /// Number of ROS 1 subscribers that do not get the message, because their queues are full. In ROS 2 the publisher
    /// waits for the subscriptions instead.
    pub dropped: usize,
}

/// Publishes a topic. Its methods block.
pub struct TopicWriter {
    inner: VersionedPublisher,
    topic: String,
    clock: SharedClock,
}

/// The fields are dropped in order: the publisher before its node, which then informs the master.
enum VersionedPublisher {
    Ros1(Publisher, #[expect(dead_code, reason = "keeps the node")] Arc<SharedNode>),
    Ros2(Box<Ros2Publisher>, #[expect(dead_code, reason = "keeps the node")] Arc<Ros2Node>),
}

impl TopicWriter {
    /// Publishes a topic with messages of the type `M`. Blocks until the topic is registered.
    ///
    /// # Errors
    /// If the environment or the name cannot be used, no master answers, or this build has no ROS 2.
    pub fn open<M: Message>(
        version: RosVersion,
        topic: &str,
        clock: &SharedClock,
    ) -> Result<Self, TopicError> {
        let inner = runtime()?.block_on(async {
            match version {
                RosVersion::Ros1 => {
                    let environment = Environment::from_process()?;
                    let publish = async |node: &crate::ros1::Node| {
                        node.publish(topic, TopicType::from_message::<M>(), PublisherOptions::default()).await
                    };
                    let (publisher, node) = open_on_ros1(&environment, clock, publish).await?;
                    Ok::<_, TopicError>(VersionedPublisher::Ros1(publisher, node))
                }
                RosVersion::Ros2 => {
                    let node = ros2_node().await?;
                    let publisher =
                        node.create_publisher(topic, M::DEFINITION.name, &QosProfile::default())?;
                    Ok(VersionedPublisher::Ros2(Box::new(publisher), node))
                }
            }
        })?;
        Ok(Self { inner, topic: topic.to_owned(), clock: SharedClock::clone(clock) })
    }

    /// Publishes a message of the type with which the topic was opened.
    ///
    /// # Errors
    /// If the node has ended, the message cannot be encoded, or subscriptions of ROS 2 do not keep up for 5 seconds.
    pub fn write<M: Message>(&self, message: &M) -> Result<WriteOutcome, TopicError> {
        let encode = |form| {
            message.encode(form).map_err(|source| TopicError::Encode { topic: self.topic.clone(), source })
        };
        match &self.inner {
            VersionedPublisher::Ros1(publisher, _) => {
                // Bytes that the kernel does not accept at once are sent on the runtime.
                let _entered = runtime()?.enter();
                let outcome = publisher.publish(encode(WireForm::Ros1)?)?;
                Ok(WriteOutcome { dropped: outcome.dropped })
            }
            VersionedPublisher::Ros2(publisher, _) => {
                let payload = encode(WireForm::Cdr)?.into_bytes();
                runtime()?.block_on(publisher.publish(payload, self.clock.wall()))?;
                Ok(WriteOutcome::default())
            }
        }
    }
}
