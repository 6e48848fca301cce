//! Settings of sessions over ROS 2.

use peernet_ros::ros2::{QosProfile, Reliability};
use serde::{Deserialize, Serialize};

use super::{InvalidSettings, TIME_RANGE_FROM_1_MS, check_range};

/// Smallest and largest value of `depth`.
const DEPTH_RANGE: (u64, u64) = (1, QosProfile::MAX_DEPTH as u64);

/// QoS and interfaces of the ROS 2 topics that carry sessions.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ros2SessionSettings {
    /// Reliability of payloads: whether lost payloads are sent again. The *companion* of a payload, the message with
    /// its header and tree, is always reliable.
    pub reliability: Reliability,
    /// Number of payloads that the queue of a topic holds (`depth` of the QoS profile).
    pub depth: u32,
    /// Longest time between two payloads that this end sends, promised to subscribers. This end also waits at most this
    /// time for a payload whose companion has arrived. Milliseconds.
    // `None` is skipped, because TOML has no null and the record of a run is written as TOML.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deadline_ms: Option<u64>,
    /// Names or IPv4 addresses of the network interfaces to use. If empty, the environment variables of ROS 2 decide.
    pub interfaces: Vec<String>,
}

impl Default for Ros2SessionSettings {
    fn default() -> Self {
        Self { reliability: Reliability::default(), depth: 16, deadline_ms: None, interfaces: Vec::new() }
    }
}

impl Ros2SessionSettings {
    pub(super) fn check(&self) -> Result<(), InvalidSettings> {
        check_range("ros2.depth", u64::from(self.depth), DEPTH_RANGE)?;
        self.deadline_ms.map_or(Ok(()), |ms| check_range("ros2.deadline_ms", ms, TIME_RANGE_FROM_1_MS))
    }

    /// Returns the settings with every value brought into the range that [`check`](Self::check) allows.
    pub(super) fn clamped(self) -> Self {
        Self {
            depth: self.depth.clamp(1, QosProfile::MAX_DEPTH),
            deadline_ms: self.deadline_ms.map(|ms| ms.clamp(TIME_RANGE_FROM_1_MS.0, TIME_RANGE_FROM_1_MS.1)),
            ..self
        }
    }
}
