//! The node that subscribes to the two observed topics.

use peernet_clock::SharedClock;
use peernet_logger::Slug;
use peernet_ros::ros1::{Environment, EnvironmentError, Node, NodeError};
use peernet_ros::topics::{RosVersion, VersionError};

use super::message::begins_with_header;
use super::topic::Topic;
use crate::config::{ObserveConfig, PairBy};

/// Why topics cannot be observed.
#[derive(Debug, thiserror::Error)]
pub(in crate::pipeline) enum SourceError {
    /// The version of ROS is not known.
    #[error(transparent)]
    Version(#[from] VersionError),
    /// A variable of ROS 1 has a value that cannot be used.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// The client of ROS 1 failed.
    #[error(transparent)]
    Ros1(#[from] NodeError),
    /// Topics of another version of ROS.
    #[error("topics of {0} cannot be observed; only those of ROS 1 can")]
    NotObservable(RosVersion),
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
            Self::Version(_) | Self::Environment(_) | Self::NotObservable(_) | Self::WithoutHeader { .. } => {
                false
            }
            Self::Ros1(error) => !matches!(error, NodeError::Name(_) | NodeError::AlreadySubscribed { .. }),
        }
    }
}

/// A node of ROS 1 that only subscribes, to the two observed topics.
pub(super) struct Source {
    node: Node,
    master: String,
    pub(super) input: Topic,
    pub(super) output: Topic,
}

impl Source {
    /// Subscribes to the topics by a node with this name, with the master and the own address that the environment
    /// variables of ROS name.
    ///
    /// # Errors
    /// The system is not one of ROS 1, a variable cannot be used, no master answers, or a name is not allowed.
    pub(super) async fn open(
        config: &ObserveConfig,
        name: &str,
        clock: &SharedClock,
    ) -> Result<Self, SourceError> {
        let version = RosVersion::resolve(config.ros_version, |name| std::env::var(name).ok())?;
        if version != RosVersion::Ros1 {
            return Err(SourceError::NotObservable(version));
        }
        let environment = Environment::from_process()?;
        let master = environment.master.to_string();
        let node = Node::new(&environment, name, SharedClock::clone(clock)).await?;
        let input = Topic::subscribe(&node, &config.input).await?;
        let output = Topic::subscribe(&node, &config.output).await?;
        Ok(Self { node, master, input, output })
    }

    /// Where it subscribes, for people.
    pub(super) fn describe(&self) -> String {
        format!("{}, master {}", RosVersion::Ros1, self.master)
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
            if let Some(kind) = topic.kind().filter(|kind| !begins_with_header(&kind.definition)) {
                let (topic, kind) = (topic.name().to_owned(), kind.name.to_string());
                return Err(SourceError::WithoutHeader { topic, kind });
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

    /// Waits until the node has ended by itself, and returns the reason.
    pub(super) async fn ended(&self) -> SourceError {
        self.node.ended().await.into()
    }

    /// Ends the subscriptions and the node.
    pub(super) async fn close(self) {
        if let Err(error) = self.node.shutdown().await {
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
