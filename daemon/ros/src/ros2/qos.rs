//! Quality of service of a topic.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Quality of service of one publisher or subscription. The defaults are the default profile of ROS 2.
///
/// A subscription only gets messages of a publisher that offers at least what the subscription requests: `reliable` and
/// `transient-local` if they are requested, and a deadline that is not longer than the requested deadline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QosProfile {
    /// Reliability of messages. Default: `reliable`.
    pub reliability: Reliability,
    /// Number of messages that a publisher keeps for late subscriptions, or that a subscription keeps until they
    /// are read; at least 1. Default: 10.
    pub depth: u32,
    /// Durability of messages. Default: `volatile`.
    pub durability: Durability,
    /// Longest time between two messages that the publisher promises or the subscription requests, milliseconds;
    /// none by default.
    pub deadline_ms: Option<f64>,
    /// Time limit for publishing if subscriptions do not keep up, milliseconds. Default: 5,000.
    pub max_blocking_ms: u32,
}

/// Policy for lost messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reliability {
    /// Messages are sent again until every matched subscription has them.
    #[default]
    Reliable,
    /// Messages are sent once.
    BestEffort,
}

/// Policy for messages that were published before a subscription existed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Durability {
    /// Only messages that are published after both ends have found each other arrive.
    #[default]
    Volatile,
    /// The last [`depth`](QosProfile::depth) messages from before that time arrive as well.
    TransientLocal,
}

impl Default for QosProfile {
    fn default() -> Self {
        Self {
            reliability: Reliability::default(),
            depth: 10,
            durability: Durability::default(),
            deadline_ms: None,
            max_blocking_ms: 5_000,
        }
    }
}

/// Error: a QoS profile is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InvalidQos {
    /// The number of kept messages is out of range.
    #[error("depth is {0}, but must be from 1 to {max}", max = QosProfile::MAX_DEPTH)]
    Depth(u32),
    /// The deadline is not a valid duration.
    #[error("deadline_ms is {0}, but must be a positive number of milliseconds of at most a day")]
    Deadline(f64),
}

impl QosProfile {
    /// Maximum number of messages that an endpoint keeps.
    pub const MAX_DEPTH: u32 = 8_192;

    /// Longest deadline, milliseconds: a day.
    const MAX_DEADLINE_MS: f64 = 24.0 * 3_600_000.0;

    /// Checks the ranges of the values.
    ///
    /// # Errors
    ///
    /// For the first value that is out of range.
    pub fn check(&self) -> Result<(), InvalidQos> {
        if !(1..=Self::MAX_DEPTH).contains(&self.depth) {
            return Err(InvalidQos::Depth(self.depth));
        }
        match self.deadline_ms {
            Some(deadline) if !(deadline > 0.0 && deadline <= Self::MAX_DEADLINE_MS) => {
                Err(InvalidQos::Deadline(deadline))
            }
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Reliability {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Reliable => "reliable",
            Self::BestEffort => "best-effort",
        })
    }
}

impl fmt::Display for Durability {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Volatile => "volatile",
            Self::TransientLocal => "transient-local",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_refused() {
        let check_with = |change: fn(&mut QosProfile)| {
            let mut qos = QosProfile::default();
            change(&mut qos);
            qos.check()
        };
        assert_eq!(check_with(|_| ()), Ok(()));
        assert_eq!(check_with(|qos| qos.depth = 0), Err(InvalidQos::Depth(0)));
        assert_eq!(check_with(|qos| qos.depth = 8_193), Err(InvalidQos::Depth(8_193)));
        assert_eq!(check_with(|qos| qos.deadline_ms = Some(33.3)), Ok(()));
        assert_eq!(check_with(|qos| qos.deadline_ms = Some(0.0)), Err(InvalidQos::Deadline(0.0)));
        assert!(check_with(|qos| qos.deadline_ms = Some(f64::NAN)).is_err());
    }

    #[test]
    fn profile_is_read_with_its_defaults() {
        let qos: QosProfile =
            serde_json::from_str(r#"{"reliability":"best-effort","depth":1}"#).expect("valid");
        let expected = QosProfile { reliability: Reliability::BestEffort, depth: 1, ..QosProfile::default() };
        assert_eq!(qos, expected);
        assert!(serde_json::from_str::<QosProfile>(r#"{"history":1}"#).is_err());
    }
}
