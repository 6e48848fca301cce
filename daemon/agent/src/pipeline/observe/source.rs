//! The node that subscribes to the two observed topics.

use std::sync::Arc;

use peernet_clock::SharedClock;
use peernet_logger::Slug;
use peernet_ros::ros1::{Environment, Node, NodeError};
use peernet_ros::ros2::{Ros2Error, Ros2Node};
use peernet_ros::topics::{RosVersion, TopicError, shared_ros2_node};

use super::topic::{Ros1Topic, Ros2Topic, Topic};
use crate::config::{ObserveConfig, ObserveError, PairBy};

/// Why topics cannot be observed.
#[derive(Debug, thiserror::Error)]
pub(in crate::pipeline) enum SourceError {
    /// The configuration cannot be followed.
    #[error(transparent)]
    Config(#[from] ObserveError),
    /// The client of ROS failed.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// The messages of a topic have nothing to be paired by.
    #[error(
        "topic {topic} has the type {kind}, which does not begin with a std_msgs/Header; write pair_by = \"order\""
    )]
    WithoutHeader {
        /// The topic.
        topic: String,
        /// Type of its messages.
        kind: String,
    },
}

impl SourceError {
    /// Whether it may pass without a change of the configuration.
    pub(super) fn may_pass(&self) -> bool {
        match self {
            Self::Config(_) | Self::WithoutHeader { .. } => false,
            Self::Topic(error) => match error {
                TopicError::Version(_) | TopicError::Environment(_) | TopicError::Name(_) => false,
                TopicError::Ros1(error) => {
                    !matches!(error, NodeError::Name(_) | NodeError::AlreadySubscribed { .. })
                }
                TopicError::Ros2(error) => !matches!(
                    error,
                    Ros2Error::NotBuilt
                        | Ros2Error::InvalidName { .. }
                        | Ros2Error::InvalidVariable { .. }
                        | Ros2Error::InvalidDomain { .. }
                ),
                _ => true,
            },
        }
    }
}

impl From<NodeError> for SourceError {
    fn from(error: NodeError) -> Self {
        Self::Topic(error.into())
    }
}

/// A node that only subscribes, to the two observed topics.
pub(super) struct Source {
    // The topics go before their node.
    pub(super) input: Topic,
    pub(super) output: Topic,
    node: SourceNode,
}

/// The node of the subscriptions.
enum SourceNode {
    /// One of its own.
    Ros1 { node: Node, master: String },
    /// The one of this process: each further node would make the publishers send every message once more.
    Ros2(Arc<Ros2Node>),
}

impl Source {
    /// Subscribes to the topics. The environment variables of ROS name the master and the own address, or the domain.
    /// A node of ROS 1 has the name `name`.
    ///
    /// # Errors
    /// The version of ROS cannot be observed, a variable cannot be used, no master answers, the domain cannot be joined, or
    /// a name is not allowed.
    pub(super) async fn open(
        config: &ObserveConfig,
        name: &str,
        clock: &SharedClock,
    ) -> Result<Self, SourceError> {
        match config.version(|name| std::env::var(name).ok())? {
            RosVersion::Ros1 => {
                let environment = Environment::from_process().map_err(TopicError::from)?;
                let master = environment.master.to_string();
                let node = Node::new(&environment, name, SharedClock::clone(clock)).await?;
                let input = Topic::Ros1(Ros1Topic::subscribe(&node, &config.input).await?);
                let output = Topic::Ros1(Ros1Topic::subscribe(&node, &config.output).await?);
                Ok(Self { input, output, node: SourceNode::Ros1 { node, master } })
            }
            RosVersion::Ros2 => {
                let node = shared_ros2_node().await?;
                let topic =
                    |name| Ok::<_, TopicError>(Topic::Ros2(Box::new(Ros2Topic::new(&node, name, clock)?)));
                let (input, output) = (topic(&config.input)?, topic(&config.output)?);
                Ok(Self { input, output, node: SourceNode::Ros2(node) })
            }
        }
    }

    /// Where it subscribes, for people.
    pub(super) fn describe(&self) -> String {
        match &self.node {
            SourceNode::Ros1 { master, .. } => format!("{}, master {master}", RosVersion::Ros1),
            SourceNode::Ros2(node) => format!("{}, {}", RosVersion::Ros2, node.describe_domain()),
        }
    }

    /// Subscribes with the types that the publishers of both topics have now.
    ///
    /// # Errors
    /// A type has a name that ROS does not allow, or the client fails.
    pub(super) fn follow_publishers(&mut self) -> Result<(), SourceError> {
        self.input.follow_publishers()?;
        Ok(self.output.follow_publishers()?)
    }

    /// Checks that the messages of both topics have what they are paired by, as far as their publishers have told.
    ///
    /// # Errors
    /// A topic's type has no header.
    pub(super) fn check_types(&self, pair_by: PairBy) -> Result<(), SourceError> {
        // The sequence number is a part of the header, too.
        if pair_by == PairBy::Order {
            return Ok(());
        }
        for topic in [&self.input, &self.output] {
            if let Some(kind) = topic.kind().filter(|kind| kind.has_header == Some(false)) {
                return Err(SourceError::WithoutHeader { topic: topic.name().to_owned(), kind: kind.name });
            }
        }
        Ok(())
    }

    /// Returns why a topic has no messages at the moment; `None` while both have a publisher.
    pub(super) fn trouble(&self) -> Option<String> {
        let troubles: Vec<String> =
            [&self.input, &self.output].into_iter().filter_map(Topic::trouble).collect();
        (!troubles.is_empty()).then(|| troubles.join("; "))
    }

    /// Returns a trouble with what was seen instead and what to do, where the version of ROS does not say it by itself.
    pub(super) fn advised(&self, trouble: &str) -> String {
        match &self.node {
            SourceNode::Ros1 { .. } => trouble.to_owned(),
            SourceNode::Ros2(node) => format!("{trouble} ({}; {})", node.describe_domain(), node.advise()),
        }
    }

    /// Waits until the node has ended by itself, and returns the reason.
    pub(super) async fn ended(&self) -> SourceError {
        match &self.node {
            SourceNode::Ros1 { node, .. } => node.ended().await.into(),
            // It lives as long as this process uses it.
            SourceNode::Ros2(_) => std::future::pending().await,
        }
    }

    /// Ends the subscriptions and the node.
    pub(super) async fn close(self) {
        let SourceNode::Ros1 { node, .. } = self.node else { return };
        if let Err(error) = node.shutdown().await {
            tracing::warn!("{error}; the master lists this node until `rosnode cleanup` removes it");
        }
    }
}

/// Returns the name of the node of a pipeline: another node of that name would end it, or be ended by it.
pub(super) fn node_name(host: &Slug, pipeline: &Slug) -> String {
    let words = ["peernet", host.as_str(), pipeline.as_str()];
    let parts =
        words.iter().flat_map(|word| word.split(|character: char| !character.is_ascii_alphanumeric()));
    parts.filter(|part| !part.is_empty()).collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn node_name_is_one_that_ros_allows() {
        let name = |host: &str, pipeline: &str| {
            node_name(&host.parse().expect("a name"), &pipeline.parse().expect("a name"))
        };
        assert_eq!(name("jetson-1.lab", "front__camera"), "peernet_jetson_1_lab_front_camera");
        assert_eq!(name("1", "2"), "peernet_1_2");
    }
}
