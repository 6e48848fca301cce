//! A topic of the observed system, in either version of ROS.

mod ros1;
mod ros2;
mod sequence_gaps;

use futures::future::Either;
use peernet_ros::topics::TopicError;

pub(super) use self::ros1::Ros1Topic;
pub(super) use self::ros2::Ros2Topic;
use super::message::TopicMessage;

/// A subscription of an observed topic.
pub(super) enum Topic {
    Ros1(Ros1Topic),
    Ros2(Box<Ros2Topic>),
}

/// Type of the messages of an observed topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ObservedType {
    /// Name in the notation of its version of ROS.
    pub(super) name: String,
    /// `true` if messages of this type begin with a `std_msgs/Header`; `None` if this cannot be seen from the type
    /// alone.
    pub(super) has_header: Option<bool>,
}

/// A publisher of an observed topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PublisherLocation {
    /// Name of the node, or of the endpoint if the node has none.
    pub(super) node: String,
    /// Address of the publisher's host; `None` for this host.
    pub(super) host: Option<String>,
}

impl PublisherLocation {
    /// Returns node and host as a text. `has_peer` is `true` if the peer's agent is on that host.
    pub(super) fn describe(&self, has_peer: bool) -> String {
        let node = &self.node;
        match &self.host {
            None => format!("{node} on this host"),
            Some(host) if has_peer => format!("{node} at {host}, where the peer measures"),
            Some(host) => format!("{node} at {host}, where this agent measures nothing"),
        }
    }
}

impl Topic {
    /// Waits for the next message. Cancel-safe.
    ///
    /// # Errors
    /// When the node has ended, or the topic cannot be subscribed to with its current type.
    pub(super) async fn next(&mut self) -> Result<TopicMessage, TopicError> {
        match self {
            Self::Ros1(topic) => topic.next().await,
            Self::Ros2(topic) => topic.next().await,
        }
    }

    /// Subscribes with the current type of the publishers.
    ///
    /// # Errors
    /// When the type has a name that ROS does not allow, or the client fails.
    pub(super) fn follow_publishers(&mut self) -> Result<(), TopicError> {
        match self {
            // A subscription in ROS 1 accepts any type.
            Self::Ros1(_) => Ok(()),
            Self::Ros2(topic) => topic.follow_publishers(),
        }
    }

    /// Returns the global name of the topic.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Ros1(topic) => topic.name(),
            Self::Ros2(topic) => topic.name(),
        }
    }

    /// Returns the type of the messages; `None` while it is unknown because there is no publisher.
    pub(super) fn kind(&self) -> Option<ObservedType> {
        match self {
            Self::Ros1(topic) => topic.kind(),
            Self::Ros2(topic) => topic.kind(),
        }
    }

    /// Returns the reason why no messages of the topic are received; `None` while the topic has a publisher whose
    /// messages can be read.
    pub(super) fn problem(&self) -> Option<String> {
        match self {
            Self::Ros1(topic) => topic.problem(),
            Self::Ros2(topic) => topic.problem(),
        }
    }

    /// Returns the publishers whose messages are received.
    pub(super) fn publishers(&self) -> Vec<PublisherLocation> {
        match self {
            Self::Ros1(topic) => topic.publishers(),
            Self::Ros2(topic) => topic.publishers(),
        }
    }

    /// Returns a future that ends when the publishers change: in ROS 1 after this call, in ROS 2 after the latest call
    /// of `follow_publishers`.
    // This is no `async fn`: its body would begin at the first poll, and a change between the call and the first poll
    // would be missed.
    pub(super) fn publishers_changed(&self) -> impl Future<Output = ()> + '_ {
        match self {
            Self::Ros1(topic) => Either::Left(topic.publishers_changed()),
            Self::Ros2(topic) => Either::Right(topic.publishers_changed()),
        }
    }

    /// Returns the number of received messages that were dropped because the agent was too slow.
    pub(super) fn dropped(&self) -> u64 {
        match self {
            Self::Ros1(topic) => topic.dropped(),
            // In ROS 2 newer messages replace unread ones. The replaced messages are counted as missing by their
            // sequence numbers.
            Self::Ros2(_) => 0,
        }
    }
}
