//! The part of an iteration's total that none of the known stages accounts for.

use peernet_logger::{Name, stage};

use crate::slowness::BOTH_DIRECTIONS;
use crate::stage_split::index_of_network;

/// Name of the sum of upload, download and unattributed time. It is used if a delay is not known
/// and the unattributed time is not known either.
pub const NETWORK_AND_REST: &str = "upload + download + unattributed";

/// Measured durations of an iteration, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IterationDurations<'a> {
    /// Duration from the intended start to the end.
    pub total: f64,
    /// Durations in the order of the stages.
    pub stages: &'a [(Name, f64)],
    /// Sum of upload and download. A step of a clock does not change the sum. `None` if both delays
    /// are known, or if the sum is not known either.
    pub both_ways: Option<f64>,
    /// Part of the total that belongs to no stage; `None` if it is not known.
    pub unattributed: Option<f64>,
    /// `true` if the delay of at least one message of the iteration is not known.
    pub has_unknown_delay: bool,
    /// `true` if the iteration has an answer.
    pub is_answered: bool,
}

/// Parts of a total that no stage accounts for, seconds: the time in the network, if the delay of
/// an upload or a download is not known, and the time that belongs to no stage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnaccountedTime {
    /// [`BOTH_DIRECTIONS`] or [`NETWORK_AND_REST`], with its duration. `None` if all delays are known. Also `None` if a
    /// delay is not known and the iteration has no answer.
    pub network: Option<(&'static str, f64)>,
    /// Time that belongs to no stage; `None` unless it is known and above zero.
    pub unattributed: Option<f64>,
}

impl UnaccountedTime {
    /// Computes the unaccounted time. If a delay is not known, the sum of upload and download that the agent measured
    /// replaces both directions.
    pub fn of(durations: &IterationDurations<'_>) -> Self {
        let IterationDurations { total, stages, both_ways, unattributed, .. } = *durations;
        let (network, unattributed) = match (both_ways, durations.has_unknown_delay) {
            (Some(both), _) => (Some((BOTH_DIRECTIONS, both)), unattributed),
            // If the unattributed time is not known, stages are missing, as in an observed system whose peer sent no
            // stamps. The rest of the total then has no name.
            (None, false) => (None, unattributed),
            // Neither the time in the network nor the unattributed time is known, but their sum is.
            (None, true) if durations.is_answered => {
                let others = stages.iter().filter(|(name, _)| !stage::is_one_way(name));
                let rest = total - others.map(|(_, seconds)| seconds).sum::<f64>();
                (Some((NETWORK_AND_REST, rest)), None)
            }
            // Without an answer, the rest may also be time on the other host or a wait for a lost message.
            (None, true) => (None, None),
        };
        let is_positive = |seconds: &f64| *seconds > 0.0;
        Self {
            network: network.filter(|(_, seconds)| is_positive(seconds)),
            unattributed: unattributed.filter(is_positive),
        }
    }

    /// Returns all parts of the total in their order: the stages and the unaccounted time.
    pub fn parts_of(durations: &IterationDurations<'_>) -> Vec<(Name, f64)> {
        let Self { network, unattributed } = Self::of(durations);
        // The sum of both directions already contains a direction whose delay is known, so that this direction is left
        // out.
        let is_separate = |(name, _): &&(Name, f64)| network.is_none() || !stage::is_one_way(name);
        let mut parts: Vec<(Name, f64)> = durations.stages.iter().filter(is_separate).cloned().collect();
        if let Some((name, seconds)) = network {
            parts.insert(index_of_network(&parts), (Name::from_static(name), seconds));
        }
        parts.extend(unattributed.map(|seconds| (stage::UNATTRIBUTED, seconds)));
        parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the parts of an iteration of 1.2 s whose download is not known. `measured` has the sum of upload and
    /// download, and the unattributed time.
    fn parts(measured: Option<(f64, f64)>, is_answered: bool) -> Vec<(String, f64)> {
        let stages = [(stage::SENSING, 0.002), (stage::UPLOAD, 0.010), (stage::INFERENCE, 0.0002)];
        let durations = IterationDurations {
            total: 1.2,
            stages: &stages,
            both_ways: measured.map(|(both_ways, _)| both_ways),
            unattributed: measured.map(|(_, unattributed)| unattributed),
            has_unknown_delay: true,
            is_answered,
        };
        let rounded = |(name, seconds): (Name, f64)| (name.to_string(), (seconds * 1e6).round() / 1e6);
        UnaccountedTime::parts_of(&durations).into_iter().map(rounded).collect()
    }

    #[test]
    fn sum_of_directions_replaces_known_direction() {
        let expected =
            [("sensing", 0.002), (BOTH_DIRECTIONS, 1.186), ("inference", 0.0002), ("unattributed", 0.0118)];
        assert_eq!(parts(Some((1.186, 0.0118)), true), expected.map(|(name, s)| (name.to_owned(), s)));
    }

    #[test]
    fn network_and_unattributed_time_are_one_part_if_inseparable() {
        let expected = [("sensing", 0.002), (NETWORK_AND_REST, 1.1978), ("inference", 0.0002)];
        assert_eq!(parts(None, true), expected.map(|(name, s)| (name.to_owned(), s)));
        let lost: Vec<String> = parts(None, false).into_iter().map(|(name, _)| name).collect();
        assert_eq!(lost, ["sensing", "upload", "inference"], "without an answer, the rest has no name");
    }

    #[test]
    fn unattributed_time_is_unknown_if_not_measured() {
        for measured in [None, Some(0.150)] {
            let durations = IterationDurations {
                total: 0.200,
                stages: &[(stage::INFERENCE, 0.050)],
                both_ways: None,
                unattributed: measured,
                has_unknown_delay: false,
                is_answered: true,
            };
            let expected = UnaccountedTime { network: None, unattributed: measured };
            assert_eq!(UnaccountedTime::of(&durations), expected);
        }
    }
}
