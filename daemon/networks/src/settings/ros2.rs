//! Settings of sessions over ROS 2.

use peernet_ros::ros2::{QosProfile, Reliability};
use serde::{Deserialize, Serialize};

use super::{InvalidSettings, OPEN_TIMEOUT_MS, between};

/// The least and the most that `depth` can be set to.
const DEPTH: (u64, u64) = (1, QosProfile::MAX_DEPTH as u64);

/// QoS and interfaces of the topics of ROS 2 that carry sessions.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ros2SessionSettings {
    /// Whether payloads that are lost on the way are sent again. All else always is.
    pub reliability: Reliability,
    /// Payloads that a topic keeps until they are taken.
    pub depth: u32,
    /// Longest time between two payloads that this end promises, and for which it waits for a payload whose companion message
    /// is there. Milliseconds.
    // The record of a run has no null, which TOML does not know.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadline_ms: Option<u64>,
    /// Names or IPv4 addresses of the network interfaces to use; none for what the environment variables of ROS 2 say.
    pub interfaces: Vec<String>,
}

impl Default for Ros2SessionSettings {
    fn default() -> Self {
        Self { reliability: Reliability::default(), depth: 16, deadline_ms: None, interfaces: Vec::new() }
    }
}

impl Ros2SessionSettings {
    pub(super) fn check(&self) -> Result<(), InvalidSettings> {
        between("ros2.depth", u64::from(self.depth), DEPTH)?;
        self.deadline_ms.map_or(Ok(()), |ms| between("ros2.deadline_ms", ms, OPEN_TIMEOUT_MS))
    }

    /// The same with every value brought into the limits of [`check`](Self::check).
    pub(super) fn clamped(self) -> Self {
        Self {
            depth: self.depth.clamp(1, QosProfile::MAX_DEPTH),
            deadline_ms: self.deadline_ms.map(|ms| ms.clamp(OPEN_TIMEOUT_MS.0, OPEN_TIMEOUT_MS.1)),
            ..self
        }
    }
}
