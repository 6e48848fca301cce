//! Quality of service of the topics of a session.

use std::time::Duration;

use peernet_ros::ros2::{EndpointRole, QosProfile, Reliability};

use crate::settings::Ros2SessionSettings;
use crate::transport::ros::interface::TopicPurpose;

/// Maximum number of companion messages (`ros/mod.rs`) that were received and not yet processed. A large payload
/// consists of many companions.
const COMPANION_DEPTH: u32 = 256;

/// Time limit for a best-effort payload whose companion has arrived.
const BEST_EFFORT_TIMEOUT: Duration = Duration::from_secs(1);

/// Quality of service of the topics of a session. The settings apply to payloads only.
#[derive(Clone, Debug)]
pub(super) struct SessionQos {
    reliability: Reliability,
    depth: u32,
    deadline_ms: Option<u64>,
}

impl SessionQos {
    pub(super) fn new(settings: &Ros2SessionSettings) -> Self {
        let Ros2SessionSettings { reliability, depth, deadline_ms, .. } = *settings;
        Self { reliability, depth, deadline_ms }
    }

    /// Returns the profile of an endpoint.
    pub(super) fn profile(&self, role: EndpointRole, purpose: TopicPurpose) -> QosProfile {
        match (purpose, role) {
            // Companions are always reliable, because they detect the loss of payloads.
            (TopicPurpose::Sessions | TopicPurpose::Refusals | TopicPurpose::Companions, _) => {
                QosProfile { depth: COMPANION_DEPTH, ..QosProfile::default() }
            }
            (TopicPurpose::Payloads, EndpointRole::Publisher) => QosProfile {
                reliability: self.reliability,
                depth: self.depth,
                deadline_ms: self.deadline_ms.map(|ms| ms as f64),
                ..QosProfile::default()
            },
            // The deadline is offered and not requested, so that the two ends need not agree on a deadline.
            (TopicPurpose::Payloads, EndpointRole::Subscription) => {
                QosProfile { reliability: self.reliability, depth: self.depth, ..QosProfile::default() }
            }
        }
    }

    /// Returns the time limit for a payload whose companion has arrived; `None` if the general
    /// limit of a connection applies.
    pub(super) fn payload_timeout(&self) -> Option<Duration> {
        let is_reliable = self.reliability == Reliability::Reliable;
        let default = (!is_reliable).then_some(BEST_EFFORT_TIMEOUT);
        self.deadline_ms.map(Duration::from_millis).or(default)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn qos(reliability: Reliability, deadline_ms: Option<u64>) -> SessionQos {
        let settings = Ros2SessionSettings { reliability, deadline_ms, ..Ros2SessionSettings::default() };
        SessionQos::new(&settings)
    }

    #[test]
    fn settings_apply_to_payloads_and_deadline_to_publisher() {
        let qos = qos(Reliability::BestEffort, Some(50));
        for role in [EndpointRole::Publisher, EndpointRole::Subscription] {
            let companions = qos.profile(role, TopicPurpose::Companions);
            assert_eq!((companions.reliability, companions.deadline_ms), (Reliability::Reliable, None));
            assert_eq!(qos.profile(role, TopicPurpose::Payloads).reliability, Reliability::BestEffort);
        }
        assert_eq!(qos.profile(EndpointRole::Publisher, TopicPurpose::Payloads).deadline_ms, Some(50.0));
        assert_eq!(qos.profile(EndpointRole::Subscription, TopicPurpose::Payloads).deadline_ms, None);
    }

    #[test]
    fn payload_timeout_follows_deadline_and_reliability() {
        let timeout = |reliability, deadline_ms| qos(reliability, deadline_ms).payload_timeout();
        assert_eq!(timeout(Reliability::Reliable, None), None);
        assert_eq!(timeout(Reliability::BestEffort, None), Some(BEST_EFFORT_TIMEOUT));
        assert_eq!(timeout(Reliability::Reliable, Some(50)), Some(Duration::from_millis(50)));
    }
}
