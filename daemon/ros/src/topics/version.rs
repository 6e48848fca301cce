//! The version of ROS that a topic belongs to.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Distributions of ROS 1; all others are of ROS 2.
const ROS1_DISTRIBUTIONS: [&str; 13] = [
    "noetic",
    "melodic",
    "lunar",
    "kinetic",
    "jade",
    "indigo",
    "hydro",
    "groovy",
    "fuerte",
    "electric",
    "diamondback",
    "cturtle",
    "boxturtle",
];

/// A version of ROS, serialized as its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum RosVersion {
    /// ROS 1: a master, and topics over TCP.
    Ros1,
    /// ROS 2: topics over DDS.
    Ros2,
}

/// Reason why the version of ROS is unknown.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum VersionError {
    /// The number is not 1 or 2.
    #[error("there is no ROS {0}; write 1 or 2")]
    Unknown(u8),
    /// Neither configuration nor environment states the version.
    #[error(
        "the version of ROS is not configured; set ros_version = 1 or 2, or the environment variable ROS_VERSION or \
         ROS_DISTRO, as the setup script of a ROS installation does"
    )]
    NotGiven,
    /// The environment variable is not 1 or 2.
    #[error("the environment variable ROS_VERSION is `{value}`, but must be 1 or 2; or set ros_version")]
    Variable {
        /// Value of the variable.
        value: String,
    },
}

impl RosVersion {
    /// Returns the version: the configured version, else `ROS_VERSION`, else the version of the distribution
    /// `ROS_DISTRO`. `variable` looks up an environment variable; an empty value counts as unset.
    ///
    /// # Errors
    /// If nothing states the version, or `ROS_VERSION` has an invalid value.
    pub fn resolve(
        configured: Option<Self>,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Self, VersionError> {
        let read_variable =
            |name| variable(name).map(|value| value.trim().to_owned()).filter(|value| !value.is_empty());
        if let Some(version) = configured {
            return Ok(version);
        }
        match read_variable("ROS_VERSION").as_deref() {
            Some("1") => Ok(Self::Ros1),
            Some("2") => Ok(Self::Ros2),
            Some(value) => Err(VersionError::Variable { value: value.to_owned() }),
            None => match read_variable("ROS_DISTRO").as_deref() {
                Some(name) if ROS1_DISTRIBUTIONS.contains(&name) => Ok(Self::Ros1),
                Some(_) => Ok(Self::Ros2),
                None => Err(VersionError::NotGiven),
            },
        }
    }
}

impl From<RosVersion> for u8 {
    fn from(version: RosVersion) -> Self {
        match version {
            RosVersion::Ros1 => 1,
            RosVersion::Ros2 => 2,
        }
    }
}

impl TryFrom<u8> for RosVersion {
    type Error = VersionError;

    fn try_from(number: u8) -> Result<Self, VersionError> {
        match number {
            1 => Ok(Self::Ros1),
            2 => Ok(Self::Ros2),
            other => Err(VersionError::Unknown(other)),
        }
    }
}

impl fmt::Display for RosVersion {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "ROS {}", u8::from(*self))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(
        configured: Option<RosVersion>,
        variables: &[(&str, &str)],
    ) -> Result<RosVersion, VersionError> {
        RosVersion::resolve(configured, |name| {
            variables.iter().find(|(variable, _)| *variable == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn configuration_precedes_environment() {
        let variables = [("ROS_VERSION", "1"), ("ROS_DISTRO", "jazzy")];
        assert_eq!(resolve(Some(RosVersion::Ros2), &variables), Ok(RosVersion::Ros2));
        assert_eq!(resolve(None, &variables), Ok(RosVersion::Ros1));
        assert_eq!(resolve(None, &variables[1..]), Ok(RosVersion::Ros2));
        assert_eq!(resolve(None, &[("ROS_VERSION", ""), ("ROS_DISTRO", "noetic")]), Ok(RosVersion::Ros1));
    }

    #[test]
    fn error_about_unknown_version_names_key() {
        assert!(resolve(None, &[]).unwrap_err().to_string().contains("set ros_version = 1 or 2"));
        let error = resolve(None, &[("ROS_VERSION", "3")]).unwrap_err();
        assert_eq!(error, VersionError::Variable { value: "3".into() });
        assert_eq!(RosVersion::try_from(3), Err(VersionError::Unknown(3)));
    }
}
