//! `placement = { kind = "observe", … }`

use peernet_ros::topics::RosVersion;
use serde::{Deserialize, Serialize};

/// `placement = { kind = "observe", … }`: nodes of a ROS system that run already, between two of its topics.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObserveConfig {
    /// Version of ROS, 1 or 2. Default: that of the environment variable `ROS_VERSION`, or else that of the distribution
    /// in `ROS_DISTRO`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ros_version: Option<RosVersion>,
    /// Topic that the observed nodes receive. Each of its messages is an iteration.
    pub input: String,
    /// Topic that they publish.
    pub output: String,
    /// How an output message is assigned to its input message. Default: `stamp`.
    #[serde(default)]
    pub pair_by: PairBy,
}

/// How an output message is assigned to its input message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PairBy {
    /// Both have the same `header.stamp`.
    #[default]
    Stamp,
    /// Both have the same sequence number: `header.seq` of ROS 1, that of the publisher in ROS 2.
    Sequence,
    /// The oldest input message without an output message is the one.
    Order,
}

impl PairBy {
    /// In words, for the page of a run.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Stamp => "header.stamp",
            Self::Sequence => "sequence number",
            Self::Order => "order of arrival",
        }
    }
}
