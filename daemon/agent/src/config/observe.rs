//! `placement = { kind = "observe", … }`

use peernet_ros::ros2::{self, Ros2Error};
use peernet_ros::topics::{RosVersion, VersionError};
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

/// Why topics cannot be observed as configured.
#[derive(Debug, thiserror::Error)]
pub enum ObserveError {
    /// The version of ROS is not known.
    #[error(transparent)]
    Version(#[from] VersionError),
    /// This build has no ROS 2.
    #[error(transparent)]
    NotBuilt(Ros2Error),
    /// Messages have nothing to be paired by.
    #[error(
        "the headers of ROS 2 have no sequence number to pair messages by; write pair_by = \"stamp\", or \"order\" where \
         the observed nodes do not copy header.stamp"
    )]
    NoSequence,
}

impl ObserveError {
    /// Returns the key of the placement that is to be changed.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Version(_) | Self::NotBuilt(_) => "ros_version",
            Self::NoSequence => "pair_by",
        }
    }
}

impl ObserveConfig {
    /// Returns the version of ROS that is observed. `variable` looks up an environment variable.
    ///
    /// # Errors
    /// Nothing says which version, or it cannot be observed so: [`ObserveError`].
    pub fn version(&self, variable: impl Fn(&str) -> Option<String>) -> Result<RosVersion, ObserveError> {
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
}

/// How an output message is assigned to its input message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PairBy {
    /// Both have the same `header.stamp`.
    #[default]
    Stamp,
    /// Both have the same sequence number, `header.seq`. ROS 1 only.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn config(pair_by: PairBy) -> ObserveConfig {
        let (input, output) = ("/in".to_owned(), "/out".to_owned());
        ObserveConfig { ros_version: Some(RosVersion::Ros2), input, output, pair_by }
    }

    #[test]
    fn sequence_numbers_of_ros_2_are_refused_with_the_alternatives() {
        let error = config(PairBy::Sequence).version(|_| None).expect_err("there are none");
        assert_eq!(error.key(), "pair_by");
        for part in ["no sequence number", "pair_by = \"stamp\"", "\"order\""] {
            assert!(error.to_string().contains(part), "{error}");
        }
        let of_ros1 = ObserveConfig { ros_version: Some(RosVersion::Ros1), ..config(PairBy::Sequence) };
        assert_eq!(of_ros1.version(|_| None).ok(), Some(RosVersion::Ros1));
    }

    #[test]
    fn build_without_ros_2_names_the_feature() {
        match config(PairBy::Stamp).version(|_| None) {
            Ok(version) => assert!(ros2::IS_BUILT && version == RosVersion::Ros2),
            Err(error) => {
                assert!(!ros2::IS_BUILT && error.to_string().contains("cargo feature `ros2`"), "{error}");
                assert_eq!(error.key(), "ros_version");
            }
        }
    }
}
