//! The placement `{ kind = "observe", … }`.

use peernet_logger::Slug;
use peernet_networks::Address;
use peernet_ros::ros2::{self, Ros2Error};
use peernet_ros::topics::{RosVersion, VersionError};
use serde::{Deserialize, Serialize};

/// `placement = { kind = "observe", … }`: the nodes of a running ROS system between two of its topics.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObserveConfig {
    /// Version of ROS, 1 or 2. Default: the version in the environment variable `ROS_VERSION`, otherwise the version of
    /// the distribution in `ROS_DISTRO`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ros_version: Option<RosVersion>,
    /// Topic that the observed nodes receive. Each of its messages is an iteration.
    pub input: String,
    /// Topic that the observed nodes publish.
    pub output: String,
    /// Rule by which an output message is assigned to its input message. Default: `stamp`.
    #[serde(default)]
    pub pair_by: PairBy,
    /// Address in `[serve] listen` of another agent, `tcp://host:port`. That agent runs on the host where the observed
    /// nodes compute, and observes the same messages there. With this key `upload`, `inference` and `download` are
    /// recorded separately. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peer: Option<Address>,
    /// Name of the pipeline of the agent at `peer`. Default: the name of this pipeline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peer_pipeline: Option<Slug>,
}

/// Reason why topics cannot be observed as configured.
#[derive(Debug, thiserror::Error)]
pub enum ObserveError {
    /// The version of ROS is not configured and cannot be derived.
    #[error(transparent)]
    Version(#[from] VersionError),
    /// This build does not include ROS 2.
    #[error(transparent)]
    NotBuilt(Ros2Error),
    /// Messages of ROS 2 have no sequence number to be paired by.
    #[error(
        "the headers of ROS 2 have no sequence number to pair messages by; set pair_by = \"stamp\", or \"order\" if the \
         observed nodes do not copy header.stamp"
    )]
    NoSequence,
    /// Two hosts cannot pair their messages by order, because they may receive them in different orders.
    #[error(
        "two hosts may receive the messages in different orders, so their stamps cannot be paired by order; set \
         pair_by = \"stamp\", or \"sequence\" in ROS 1, or remove peer"
    )]
    PeerByOrder,
    /// `peer_pipeline` is set without `peer`.
    #[error("peer_pipeline needs a peer; add peer = \"tcp://HOST:PORT\", or remove peer_pipeline")]
    PipelineWithoutPeer,
}

impl ObserveError {
    /// Returns the key of the placement that has to be changed.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Version(_) | Self::NotBuilt(_) => "ros_version",
            Self::NoSequence | Self::PeerByOrder => "pair_by",
            Self::PipelineWithoutPeer => "peer_pipeline",
        }
    }
}

impl ObserveConfig {
    /// Returns the version of ROS that is observed. `variable` looks up an environment variable.
    ///
    /// # Errors
    /// When the version is unknown or not in this build, or when messages are paired by sequence number and messages of
    /// this version have none.
    pub fn resolve_version(
        &self,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<RosVersion, ObserveError> {
        let version = RosVersion::resolve(self.ros_version, variable)?;
        if version == RosVersion::Ros2 {
            if self.pair_by == PairBy::Sequence {
                return Err(ObserveError::NoSequence);
            }
            if !ros2::IS_BUILT {
                return Err(ObserveError::NotBuilt(Ros2Error::NotBuilt));
            }
        }
        Ok(version)
    }

    /// If there is a peer, checks that the stamps of messages can be matched with the peer's stamps.
    ///
    /// # Errors
    /// When messages are paired by order, or `peer_pipeline` is set without `peer`.
    pub fn check_peer(&self) -> Result<(), ObserveError> {
        if self.peer.is_some() && self.pair_by == PairBy::Order {
            return Err(ObserveError::PeerByOrder);
        }
        if self.peer.is_none() && self.peer_pipeline.is_some() {
            return Err(ObserveError::PipelineWithoutPeer);
        }
        Ok(())
    }
}

/// Rule by which an output message is assigned to its input message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PairBy {
    /// Both messages have the same `header.stamp`.
    #[default]
    Stamp,
    /// Both messages have the same sequence number, `header.seq`. ROS 1 only.
    Sequence,
    /// The output message belongs to the oldest input message that has no output message yet.
    Order,
}

impl PairBy {
    /// Returns the rule as a text, for the page of a run.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Stamp => "header.stamp",
            Self::Sequence => "sequence number",
            Self::Order => "order of arrival",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(pair_by: PairBy) -> ObserveConfig {
        let (input, output) = ("/in".to_owned(), "/out".to_owned());
        let (peer, peer_pipeline) = (None, None);
        ObserveConfig { ros_version: Some(RosVersion::Ros2), input, output, pair_by, peer, peer_pipeline }
    }

    #[test]
    fn peer_is_refused_if_messages_are_paired_by_order() {
        let peer = Some("tcp://rack:5551".parse().expect("an address"));
        let by_order = ObserveConfig { peer: peer.clone(), ..config(PairBy::Order) };
        let error = by_order.check_peer().expect_err("it is refused");
        assert_eq!(error.key(), "pair_by");
        for part in ["pair_by = \"stamp\"", "\"sequence\""] {
            assert!(error.to_string().contains(part), "{error}");
        }
        let without_peer = ObserveConfig { peer_pipeline: Some(Slug::observed()), ..config(PairBy::Stamp) };
        assert_eq!(without_peer.check_peer().map_err(|error| error.key()), Err("peer_pipeline"));
        for pair_by in [PairBy::Stamp, PairBy::Sequence] {
            assert!(ObserveConfig { peer: peer.clone(), ..config(pair_by) }.check_peer().is_ok());
        }
    }

    #[test]
    fn sequence_numbers_are_refused_in_ros_2() {
        let error =
            config(PairBy::Sequence).resolve_version(|_| None).expect_err("ROS 2 has no sequence numbers");
        assert_eq!(error.key(), "pair_by");
        for part in ["no sequence number", "pair_by = \"stamp\"", "\"order\""] {
            assert!(error.to_string().contains(part), "{error}");
        }
        let ros1_config = ObserveConfig { ros_version: Some(RosVersion::Ros1), ..config(PairBy::Sequence) };
        assert_eq!(ros1_config.resolve_version(|_| None).ok(), Some(RosVersion::Ros1));
    }

    #[test]
    fn build_without_ros_2_names_the_feature() {
        match config(PairBy::Stamp).resolve_version(|_| None) {
            Ok(version) => assert!(ros2::IS_BUILT && version == RosVersion::Ros2),
            Err(error) => {
                assert!(!ros2::IS_BUILT && error.to_string().contains("cargo feature `ros2`"), "{error}");
                assert_eq!(error.key(), "ros_version");
            }
        }
    }
}
