//! The node that subscribes to the two observed topics.

use std::sync::Arc;

use peernet_clock::SharedClock;
use peernet_logger::Slug;
use peernet_ros::ros1::{Environment, Node, NodeError};
use peernet_ros::ros2::{Ros2Error, Ros2Node};
use peernet_ros::topics::{RosVersion, TopicError, shared_ros2_node};

use super::topic::{Ros1Topic, Ros2Topic, Topic};
use crate::config::{ObserveConfig, ObserveError, PairBy};

/// Reason why topics cannot be observed.
#[derive(Debug, thiserror::Error)]
pub(in crate::pipeline) enum SourceError {
    /// The configuration cannot be used.
    #[error(transparent)]
    Config(#[from] ObserveError),
    /// The ROS client failed.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// The messages of a topic have no header to be paired by.
    #[error(
        "topic {topic} has the type {kind}, which does not begin with a std_msgs/Header; set pair_by = \"order\""
    )]
    WithoutHeader {
        /// Name of the topic.
        topic: String,
        /// Type of its messages.
        kind: String,
    },
}

impl SourceError {
    /// Returns whether a retry may succeed without a change of the configuration.
    pub(super) fn is_temporary(&self) -> bool {
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

/// A node that subscribes to the two observed topics, and does nothing else.
pub(super) struct Source {
    // The fields are dropped in this order, so that the subscriptions end before their node.
    pub(super) input: Topic,
    pub(super) output: Topic,
    node: SourceNode,
}

/// The node of the subscriptions.
enum SourceNode {
    /// A separate node for each pipeline.
    Ros1 { node: Node, master: String },
    /// The shared node of this process. With a separate participant for each pipeline, publishers would send every
    /// message once per pipeline.
    Ros2(Arc<Ros2Node>),
}

impl Source {
    /// Subscribes to the topics. The environment variables of ROS name the master and this host's address, or the
    /// domain. A node of ROS 1 gets the name `name`.
    ///
    /// # Errors
    /// When the version of ROS cannot be observed, a variable or name is invalid, no master answers, or the domain
    /// cannot be joined.
    pub(super) async fn open(
        config: &ObserveConfig,
        name: &str,
        clock: &SharedClock,
    ) -> Result<Self, SourceError> {
        match config.resolve_version(|name| std::env::var(name).ok())? {
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

    /// Returns the version of ROS and the master or domain, as a text for the run's page.
    pub(super) fn describe(&self) -> String {
        match &self.node {
            SourceNode::Ros1 { master, .. } => format!("{}, master {master}", RosVersion::Ros1),
            SourceNode::Ros2(node) => format!("{}, {}", RosVersion::Ros2, node.describe_domain()),
        }
    }

    /// Subscribes with the current types of the publishers of both topics.
    ///
    /// # Errors
    /// When a type has a name that ROS does not allow, or the client fails.
    pub(super) fn follow_publishers(&mut self) -> Result<(), SourceError> {
        self.input.follow_publishers()?;
        Ok(self.output.follow_publishers()?)
    }

    /// Checks that the messages of both topics have a key to be paired by, as far as their publishers' types are
    /// known.
    ///
    /// # Errors
    /// When a topic's type has no header.
    pub(super) fn check_types(&self, pair_by: PairBy) -> Result<(), SourceError> {
        // The stamp and the sequence number are in the header. Only pairing by order needs no header.
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

    /// Returns the reason why no messages of a topic are received; `None` while both topics have a publisher whose
    /// messages can be read.
    pub(super) fn problem(&self) -> Option<String> {
        let problems: Vec<String> =
            [&self.input, &self.output].into_iter().filter_map(Topic::problem).collect();
        (!problems.is_empty()).then(|| problems.join("; "))
    }

    /// Returns the text of a problem, in ROS 2 with the domain and with advice.
    pub(super) fn with_advice(&self, problem: &str) -> String {
        match &self.node {
            SourceNode::Ros1 { .. } => problem.to_owned(),
            SourceNode::Ros2(node) => format!("{problem} ({}; {})", node.describe_domain(), node.advise()),
        }
    }

    /// Waits until the node has ended unexpectedly, and returns the reason.
    pub(super) async fn ended(&self) -> SourceError {
        match &self.node {
            SourceNode::Ros1 { node, .. } => node.ended().await.into(),
            // The shared node lives as long as this process uses it.
            SourceNode::Ros2(_) => std::future::pending().await,
        }
    }

    /// Closes the subscriptions and, in ROS 1, the node. The shared node of ROS 2 stays open.
    pub(super) async fn close(self) {
        let SourceNode::Ros1 { node, .. } = self.node else { return };
        if let Err(error) = node.shutdown().await {
            tracing::warn!("{error}; the master still lists this node; remove it with `rosnode cleanup`");
        }
    }
}

/// Returns the name of a pipeline's node. The name is unique per host and pipeline, because a second node with the same
/// name would end the first node.
pub(super) fn node_name(host: &Slug, pipeline: &Slug) -> String {
    // ROS allows only letters, digits and underscores in a name. The prefix `peernet` is fixed, because a name must
    // begin with a letter.
    let components = ["peernet", host.as_str(), pipeline.as_str()];
    let alphanumeric_parts = components
        .iter()
        .flat_map(|component| component.split(|character: char| !character.is_ascii_alphanumeric()));
    alphanumeric_parts.filter(|part| !part.is_empty()).collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn node_name_is_valid_in_ros() {
        let name = |host: &str, pipeline: &str| {
            node_name(&host.parse().expect("a name"), &pipeline.parse().expect("a name"))
        };
        assert_eq!(name("jetson-1.lab", "front__camera"), "peernet_jetson_1_lab_front_camera");
        assert_eq!(name("1", "2"), "peernet_1_2");
    }
}
