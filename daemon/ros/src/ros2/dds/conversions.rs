//! Conversions between our types and the types of `rustdds`.

use peernet_clock::WallTime;
use rustdds::policy::{self, History, ResourceLimits};
use rustdds::qos::QosPolicyId;
use rustdds::{Duration, GUID, QosPolicies, QosPolicyBuilder, Timestamp};

use crate::ros2::{Durability, EndpointId, EndpointRole, QosProfile, Refusal, Reliability};

const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// Smallest limit on the number of unacknowledged messages, regardless of the depth. With a lower limit, a fast
/// publisher would often wait for acknowledgments. `Ros2Publisher` limits the bytes of these messages.
const MIN_UNACKNOWLEDGED: i32 = 1_024;

/// Smallest limit on the number of received and unread messages, regardless of the depth.
const MIN_UNREAD: i32 = 8;

pub(super) fn endpoint_id(guid: GUID) -> EndpointId {
    EndpointId(guid.to_bytes())
}

/// Returns the policies of an endpoint. The caller has checked the profile with [`QosProfile::check`].
pub(super) fn qos_policies(role: EndpointRole, qos: &QosProfile) -> QosPolicies {
    let depth = i32::try_from(qos.depth).unwrap_or(i32::MAX);
    let reliability = match qos.reliability {
        Reliability::Reliable => {
            policy::Reliability::Reliable { max_blocking_time: seconds(f64::from(qos.max_blocking_ms) / 1e3) }
        }
        Reliability::BestEffort => policy::Reliability::BestEffort,
    };
    let durability = match qos.durability {
        Durability::Volatile => policy::Durability::Volatile,
        Durability::TransientLocal => policy::Durability::TransientLocal,
    };
    // Without limits rustdds keeps 64 received messages and up to 8,192 unacknowledged messages. At 1 MB each, this is
    // far more memory than the depth suggests.
    let sample_limit = match role {
        EndpointRole::Publisher => depth.max(MIN_UNACKNOWLEDGED),
        EndpointRole::Subscription => depth.max(MIN_UNREAD),
    };
    let limits = ResourceLimits {
        max_samples: sample_limit,
        // A topic without keys has one instance.
        max_instances: 1,
        max_samples_per_instance: sample_limit,
    };
    let mut builder = QosPolicyBuilder::new()
        .reliability(reliability)
        .durability(durability)
        .history(History::KeepLast { depth })
        .resource_limits(limits);
    if let Some(deadline_ms) = qos.deadline_ms {
        builder = builder.deadline(policy::Deadline(seconds(deadline_ms / 1e3)));
    }
    builder.build()
}

fn seconds(seconds: f64) -> Duration {
    Duration::from_frac_seconds(seconds)
}

/// Returns the reason why two endpoints do not match.
pub(super) fn incompatibility(offered: &QosPolicies, requested: &QosPolicies) -> Refusal {
    let failed_policy = offered.compliance_failure_wrt(requested);
    let describe = |qos: &QosPolicies| match failed_policy {
        Some(QosPolicyId::Reliability) => qos.reliability().map(|value| match value {
            policy::Reliability::Reliable { .. } => Reliability::Reliable.to_string(),
            policy::Reliability::BestEffort => Reliability::BestEffort.to_string(),
        }),
        Some(QosPolicyId::Durability) => qos.durability().map(|value| match value {
            policy::Durability::Volatile => Durability::Volatile.to_string(),
            policy::Durability::TransientLocal => Durability::TransientLocal.to_string(),
            other => format!("{other:?}"),
        }),
        Some(QosPolicyId::Deadline) => {
            qos.deadline().map(|value| format!("{} ms", value.0.to_std().as_secs_f64() * 1e3))
        }
        _ => None,
    };
    Refusal::IncompatibleQos {
        policy: failed_policy.map_or_else(|| "unknown".to_owned(), |id| format!("{id:?}").to_lowercase()),
        offered: describe(offered).unwrap_or_else(|| "its default".to_owned()),
        requested: describe(requested).unwrap_or_else(|| "its default".to_owned()),
    }
}

/// Converts a time to its RTPS form: seconds and binary fractions of a second since 1970. A time before 1970 or after
/// 2106 becomes the nearest representable time.
pub(super) fn timestamp(time: WallTime) -> Timestamp {
    let nanos = time.unix_nanos().max(0);
    // The two highest timestamps, which have `u32::MAX` seconds, are reserved.
    let seconds = u64::try_from(nanos / NANOS_PER_SECOND).unwrap_or(0).min(u64::from(u32::MAX - 1));
    let subsecond_nanos = u64::try_from(nanos % NANOS_PER_SECOND).unwrap_or(0);
    Timestamp::from_ticks((seconds << 32) | ((subsecond_nanos << 32) / NANOS_PER_SECOND.unsigned_abs()))
}

/// Converts an RTPS timestamp; `None` for the values that mean no time.
pub(super) fn wall_time(timestamp: Timestamp) -> Option<WallTime> {
    if [Timestamp::INVALID, Timestamp::INFINITE, Timestamp::ZERO].contains(&timestamp) {
        return None;
    }
    let ticks = timestamp.to_ticks();
    let fraction = ticks & u64::from(u32::MAX);
    // Rounding to the nearest nanosecond makes this function the inverse of `timestamp`.
    let nanos = (fraction * NANOS_PER_SECOND.unsigned_abs() + (1 << 31)) >> 32;
    let seconds = i64::try_from(ticks >> 32).unwrap_or(0);
    Some(WallTime::from_unix_nanos(seconds * NANOS_PER_SECOND + i64::try_from(nanos).unwrap_or(0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_exact_to_the_nanosecond() {
        for nanos in
            [1, 999_999_999, 1_700_000_000_123_456_789, 1_795_000_000_000_000_001, 4_000_000_000_999_999_999]
        {
            let time = WallTime::from_unix_nanos(nanos);
            assert_eq!(wall_time(timestamp(time)), Some(time), "{nanos}");
        }
        assert_eq!(wall_time(Timestamp::INVALID), None);
        assert_eq!(
            wall_time(timestamp(WallTime::from_unix_nanos(-5))),
            None,
            "a time before 1970 becomes zero, which means no time"
        );
        assert!(wall_time(timestamp(WallTime::from_unix_nanos(i64::MAX))).is_some());
    }

    #[test]
    fn incompatibility_names_policy_and_both_values() {
        let requested = qos_policies(EndpointRole::Subscription, &QosProfile::default());
        let offered = qos_policies(
            EndpointRole::Publisher,
            &QosProfile { reliability: Reliability::BestEffort, ..QosProfile::default() },
        );
        let expected = Refusal::IncompatibleQos {
            policy: "reliability".into(),
            offered: "best-effort".into(),
            requested: "reliable".into(),
        };
        assert_eq!(incompatibility(&offered, &requested), expected);
    }
}
