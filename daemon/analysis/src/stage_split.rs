//! Split of the mean total latency into the means of its stages.

use peernet_logger::{Name, stage};
use peernet_statistics::Moments;

use crate::rows::{LATENESS, RowRef, Rows};
use crate::slowness::{self, BOTH_DIRECTIONS, REST_OF_UNATTRIBUTED};

/// If the time that belongs to no stage is at most this share of the total, the time is a rounding error.
const MIN_UNATTRIBUTED_SHARE: f64 = 1e-9;
/// If at least this share of the total is unexplained, the trust report has a caveat and the overview warns.
pub const NOTABLE_UNEXPLAINED_SHARE: f64 = 0.05;
/// Unexplained time or lateness that is shorter than this number of seconds is negligible, even if it is a large share
/// of the total: it is the normal cost of instructions and of the scheduler.
const NEGLIGIBLE_S: f64 = 1e-4;

/// Parts that add up to the mean total latency, unless the clocks show a stage as longer than it was.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StageSplit {
    /// Mean of each part per iteration, seconds, in the order of the stages. The last part is `unattributed`, if there
    /// is time that belongs to no stage.
    pub parts: Vec<(Name, f64)>,
    /// Mean of the total, seconds; 0 without a total.
    pub total: f64,
    /// Mean time from the intended to the real start, seconds; `None` in a closed loop.
    pub lateness: Option<f64>,
    /// Part of `unattributed` that is lateness, seconds; 0 in a closed loop. It is `lateness`, but at most
    /// `unattributed`: if the clocks disagree, `lateness` can be longer than `unattributed`.
    pub unattributed_lateness: f64,
    /// Mean wait for the restart of the model's process, seconds. This wait is a part of `unattributed`, because it is
    /// not a stage. A wait for the restart of the process of a sensor or actuator is a part of the stage that waited.
    pub model_restarts: f64,
    /// Total minus all stages, seconds; negative if stages overlap. `None` unless all stages of at least one iteration
    /// are known.
    known_unattributed: Option<f64>,
}

/// Number of values of a node, and their mean in seconds.
pub type CountAndMean = (u64, f64);

impl StageSplit {
    /// Splits the mean of the total. `mean_of` returns the number and the mean of a node's values; `None` without
    /// values. `sent` holds the number of iterations that sent a message to the other host, and the number of
    /// iterations that received a message from it. The delays of some of these messages may be unknown. The result is
    /// empty without a total.
    ///
    /// A stage that an iteration does not have counts as 0 in this iteration. An unknown delay counts as the mean of
    /// the known delays. If neither upload nor download is known, because the clocks are not related, their sum
    /// replaces them. The sum needs no clock relation.
    pub fn new(sent: [u64; 2], mean_of: impl Fn(&str) -> Option<CountAndMean>) -> Self {
        let Some((iterations, total)) = mean_of(&stage::TOTAL) else { return Self::default() };
        let mean = |name: &Name| {
            let (count, mean) = mean_of(name)?;
            // A message with an unknown delay has no value, but it took time.
            let sent_count = match name {
                name if *name == stage::UPLOAD => sent[0],
                name if *name == stage::DOWNLOAD => sent[1],
                _ => 0,
            };
            Some(mean_per_iteration((count.max(sent_count), mean), iterations))
        };
        let mut parts: Vec<(Name, f64)> =
            stage::ORDER.iter().filter_map(|name| Some((name.clone(), mean(name)?))).collect();
        let was_sent = sent.iter().any(|count| *count > 0);
        let is_direction = |(name, _): &(Name, f64)| stage::is_one_way(name);
        if was_sent && !parts.iter().any(is_direction) {
            let others = parts.iter().map(|(_, seconds)| *seconds);
            let recorded_unattributed = mean_of(&stage::UNATTRIBUTED).map(|(_, mean)| mean);
            let sum = recorded_unattributed.map(|recorded| slowness::both_ways(total, others, recorded));
            let index = index_of_network(&parts);
            parts.splice(
                index..index,
                sum.filter(|sum| *sum > 0.0).map(|sum| (Name::from_static(BOTH_DIRECTIONS), sum)),
            );
        }
        let unattributed = total - parts.iter().map(|(_, seconds)| seconds).sum::<f64>();
        if unattributed > MIN_UNATTRIBUTED_SHARE * total {
            parts.push((stage::UNATTRIBUTED, unattributed));
        }
        // If no iteration has a value of `unattributed`, this time may belong to a stage whose duration is unknown.
        let known_unattributed = mean_of(&stage::UNATTRIBUTED).map(|_| unattributed);
        let per_iteration = |name: &str| mean_of(name).map(|values| mean_per_iteration(values, iterations));
        let lateness = per_iteration(LATENESS);
        Self {
            parts,
            total,
            lateness,
            unattributed_lateness: lateness.unwrap_or_default().clamp(0.0, unattributed.max(0.0)),
            model_restarts: per_iteration(&stage::RESTART).unwrap_or_default(),
            known_unattributed,
        }
    }

    /// Returns the time that neither a stage nor a late start nor the restart of a process of the model explains,
    /// seconds; negative if stages overlap. `None` unless all stages of at least one iteration are known.
    pub fn unexplained(&self) -> Option<f64> {
        Some(self.known_unattributed? - self.lateness.unwrap_or_default() - self.model_restarts)
    }

    /// Returns the stages that took time, longest first. `unattributed` is no stage.
    pub fn longest_stages(&self) -> Vec<&(Name, f64)> {
        let is_stage = |(name, seconds): &&(Name, f64)| *seconds > 0.0 && *name != stage::UNATTRIBUTED;
        let mut stages: Vec<&(Name, f64)> = self.parts.iter().filter(is_stage).collect();
        stages.sort_by(|(_, a), (_, b)| b.total_cmp(a));
        stages
    }

    /// Returns the share of these seconds in the mean total; 0 without a total.
    pub fn share_of_mean_total(&self, seconds: f64) -> f64 {
        if self.total > 0.0 { seconds / self.total } else { 0.0 }
    }

    /// Returns whether this unexplained time or lateness is long enough to be reported: longer than negligible, and at
    /// least the share `notable_share` of the total.
    pub fn is_notable(&self, seconds: f64, notable_share: f64) -> bool {
        seconds.abs() >= NEGLIGIBLE_S && self.share_of_mean_total(seconds.abs()) >= notable_share
    }

    /// Returns the split of the rows of a run that are in the statistics.
    pub fn from_rows(rows: &Rows) -> Self {
        let sent = sent_in_rows(rows.iter().filter(RowRef::is_in_statistics));
        let mean_of = |name: &str| {
            let moments: Moments = rows.values_in_statistics(name).collect();
            (moments.count > 0).then_some((moments.count, moments.mean))
        };
        Self::new(sent, mean_of)
    }

    /// Returns the time that belongs to no stage, minus the lateness in it, seconds.
    pub fn unattributed_without_lateness(&self) -> f64 {
        let unattributed = self.parts.last().filter(|(name, _)| *name == stage::UNATTRIBUTED);
        unattributed.map_or(0.0, |(_, seconds)| seconds - self.unattributed_lateness)
    }
}

/// Returns the share of a node in the mean total, 0 to 1. The node is a part of the split or any other node, such as a
/// part of a stage. `None` without a total or without values of the node. For `sent` and `mean_of`, see
/// [`StageSplit::new`].
pub fn share_of_total(
    name: &str,
    sent: [u64; 2],
    mean_of: impl Fn(&str) -> Option<CountAndMean>,
) -> Option<f64> {
    let (iterations, _) = mean_of(&stage::TOTAL).filter(|(_, total)| *total > 0.0)?;
    let split = StageSplit::new(sent, &mean_of);
    let part = split.parts.iter().find(|(part, _)| part == name).map(|(_, seconds)| *seconds);
    let seconds = part.or_else(|| Some(mean_per_iteration(mean_of(name)?, iterations)))?;
    Some(split.share_of_mean_total(seconds))
}

/// Returns the number of rows whose iteration sent a message to the other host, and the number of rows whose iteration
/// received one.
pub(crate) fn sent_in_rows<'a>(rows: impl Iterator<Item = RowRef<'a>>) -> [u64; 2] {
    rows.fold([0; 2], |[sent, received], row| {
        let [has_sent, has_received] = row.has_messages();
        [sent + u64::from(has_sent), received + u64::from(has_received)]
    })
}

/// Returns the numbers of messages that were sent and received in a part of a run with `in_part` iterations. `sent`
/// holds the numbers of the whole run, which has `iterations` iterations. The messages are assumed to be spread evenly
/// over the iterations: in most runs, each iteration sends one message. A run with messages has at least one message in
/// each part, so that the direction is not left out.
pub fn sent_in_part(sent: [u64; 2], iterations: u64, in_part: u64) -> [u64; 2] {
    let share = in_part as f64 / iterations.max(1) as f64;
    sent.map(|count| ((count as f64 * share).round() as u64).max(count.min(1)))
}

/// Returns the names of all parts that a total can have, in their order.
pub fn part_order() -> impl Iterator<Item = Name> {
    // The part for both directions comes before `upload`.
    let both_directions =
        |name: &Name| (*name == stage::UPLOAD).then_some(Name::from_static(BOTH_DIRECTIONS));
    let stages =
        stage::ORDER.into_iter().flat_map(move |name| both_directions(&name).into_iter().chain([name]));
    stages.chain([LATENESS, REST_OF_UNATTRIBUTED].map(Name::from_static)).chain([stage::UNATTRIBUTED])
}

/// Returns the index in `parts` at which the time of both directions belongs.
pub(crate) fn index_of_network(parts: &[(Name, f64)]) -> usize {
    let parts_before: Vec<Name> = part_order().take_while(|name| *name != BOTH_DIRECTIONS).collect();
    parts.iter().filter(|(name, _)| parts_before.contains(name)).count()
}

/// Returns the mean of a node per iteration, from the number and the mean of its values. Iterations without the node
/// count as 0.
pub fn mean_per_iteration((count, mean): CountAndMean, iterations: u64) -> f64 {
    mean * count as f64 / iterations.max(1) as f64
}

/// Returns the mean of a node per iteration over groups of iterations. A group, such as all iterations of a second, is
/// given as its number of iterations and its mean per iteration. The mean is `None` if the group does not have the
/// node; the iterations of such a group count as 0. Returns `None` without iterations, or if no group has the node.
pub fn mean_of_groups(groups: impl IntoIterator<Item = (u64, Option<f64>)>) -> Option<f64> {
    let (mut iterations, mut sum) = (0, None);
    for (count, mean) in groups {
        iterations += count;
        if let Some(mean) = mean {
            *sum.get_or_insert(0.0) += mean * count as f64;
        }
    }
    sum.filter(|_| iterations > 0).map(|sum| sum / iterations as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Splits a mean total of 20 ms over 50 iterations. Each node is given as its name, the number of its values and
    /// their mean. Returns the parts in milliseconds.
    fn split(sent: u64, nodes: &[(&str, u64, f64)]) -> Vec<(String, f64)> {
        let mean_of = |name: &str| {
            let node = [("total", 50, 0.020)].into_iter().chain(nodes.iter().copied());
            node.into_iter().find(|(node, ..)| *node == name).map(|(_, count, mean)| (count, mean))
        };
        let StageSplit { parts, .. } = StageSplit::new([sent; 2], mean_of);
        let milliseconds = |seconds: f64| (seconds * 1e6).round() / 1e3;
        parts.into_iter().map(|(name, seconds)| (name.to_string(), milliseconds(seconds))).collect()
    }

    fn part(name: &str, milliseconds: f64) -> (String, f64) {
        (name.to_owned(), milliseconds)
    }

    #[test]
    fn rest_of_total_is_unattributed() {
        let parts = split(0, &[("sensing", 50, 0.005), ("upload", 50, 0.010)]);
        assert_eq!(parts, [part("sensing", 5.0), part("upload", 10.0), part("unattributed", 5.0)]);
        assert_eq!(split(0, &[("sensing", 50, 0.020)]), [part("sensing", 20.0)]);
    }

    #[test]
    fn stage_of_few_iterations_is_spread_over_all() {
        let parts = split(0, &[("sensing", 50, 0.005), ("ipc", 10, 0.010)]);
        assert_eq!(parts, [part("sensing", 5.0), part("ipc", 2.0), part("unattributed", 13.0)]);
    }

    #[test]
    fn unknown_delays_count_as_mean_of_known_ones() {
        let nodes = [("upload", 25, 0.010), ("download", 50, 0.004)];
        assert_eq!(
            split(50, &nodes),
            [part("upload", 10.0), part("download", 4.0), part("unattributed", 6.0)]
        );
    }

    #[test]
    fn messages_of_part_are_proportional_to_its_iterations() {
        assert_eq!(sent_in_part([300, 290], 300, 60), [60, 58]);
        assert_eq!(sent_in_part([1, 0], 300, 60), [1, 0], "at least one message was sent");
    }

    #[test]
    fn unknown_directions_are_shown_as_their_sum() {
        let nodes = [("sensing", 50, 0.004), ("inference", 50, 0.003), ("unattributed", 50, 0.001)];
        let expected = [
            part("sensing", 4.0),
            part(BOTH_DIRECTIONS, 12.0),
            part("inference", 3.0),
            part("unattributed", 1.0),
        ];
        assert_eq!(split(50, &nodes), expected);
        let local = split(0, &nodes);
        assert_eq!(local, [part("sensing", 4.0), part("inference", 3.0), part("unattributed", 13.0)]);
    }

    #[test]
    fn shares_of_parts_agree_with_split() {
        let mean_of = |name: &str| match name {
            "total" => Some((50, 0.020)),
            "upload" => Some((25, 0.010)),
            "inference" => Some((25, 0.008)),
            "capture" => Some((50, 0.002)),
            _ => None,
        };
        let share = |name: &str| share_of_total(name, [50, 50], mean_of).map(|share| (share * 1e3).round());
        assert_eq!(
            ["upload", "inference", "unattributed", "capture", "total", "sensing"].map(share),
            [Some(500.0), Some(200.0), Some(300.0), Some(100.0), Some(1_000.0), None]
        );
    }

    #[test]
    fn groups_are_weighted_by_their_iterations() {
        assert_eq!(mean_of_groups([(10, Some(2.0)), (30, Some(4.0)), (40, None)]), Some(1.75));
        assert_eq!([mean_of_groups([(10, None)]), mean_of_groups([(0, Some(1.0))])], [None, None]);
    }

    #[test]
    fn lateness_and_restart_count_as_explained() {
        let split_of = |nodes: &'static [(&'static str, u64, f64)]| {
            StageSplit::new([0; 2], |name| {
                nodes.iter().find(|(node, ..)| *node == name).map(|(_, count, mean)| (*count, *mean))
            })
        };
        let split = split_of(&[
            ("total", 50, 0.020),
            ("sensing", 50, 0.010),
            ("unattributed", 40, 0.010),
            ("lateness", 50, 0.004),
            ("restart", 1, 0.250),
        ]);
        let unexplained = split.unexplained().expect("stages are known");
        assert!((unexplained - 0.001).abs() < 1e-12 && !split.is_notable(unexplained, 0.06), "{split:?}");
        assert!(split.is_notable(unexplained, 0.04) && split.is_notable(-unexplained, 0.04));
        assert!(!split.is_notable(0.9 * NEGLIGIBLE_S, 0.0));
        // No iteration has a value of `unattributed`, so the other 10 ms may belong to a stage whose duration is unknown.
        assert_eq!(split_of(&[("total", 50, 0.020), ("sensing", 50, 0.010)]).unexplained(), None);
        let overlap = split_of(&[("total", 50, 0.020), ("sensing", 50, 0.030), ("unattributed", 50, -0.010)]);
        assert!(
            (overlap.unexplained().expect("known") + 0.010).abs() < 1e-12
                && overlap.unattributed_lateness == 0.0
        );
    }

    #[test]
    fn lateness_is_part_of_unattributed_time() {
        let split = |lateness: f64| {
            StageSplit::new([0; 2], |name| match name {
                "total" => Some((50, 0.020)),
                "sensing" => Some((50, 0.015)),
                "lateness" => Some((50, lateness)),
                _ => None,
            })
        };
        let with_lateness = split(0.003);
        assert!((with_lateness.unattributed_without_lateness() - 0.002).abs() < 1e-12);
        assert!(
            split(0.009).unattributed_without_lateness().abs() < 1e-12,
            "the lateness counts at most as long as the unattributed time"
        );
    }

    #[test]
    fn nothing_is_split_without_total() {
        let without_total = StageSplit::new([1; 2], |name| (name != "total").then_some((1, 1.0)));
        assert_eq!(without_total, StageSplit::default());
    }
}
