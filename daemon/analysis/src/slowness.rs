//! Causes of slow iterations, by comparison with the medians of their run.

use std::ops::Range;

use peernet_logger::{Name, stage};
use serde::Serialize;

use crate::rows::LATENESS;

/// Name of the sum of upload and download. The sum is shown for runs in which only the sum is known, because the clocks
/// are not related.
pub const BOTH_DIRECTIONS: &str = "upload + download";

/// Name of the unattributed time without the lateness, where the lateness is a separate part.
pub const REST_OF_UNATTRIBUTED: &str = "rest of unattributed";

/// Ratios of an iteration's total to the median total of its run that are usual. An iteration with
/// a larger ratio is slow.
pub const USUAL_RATIOS: Range<f64> = 0.95..1.05;
/// Causes are listed until they explain this share of the time by which an iteration took longer than the median.
const MIN_EXPLAINED_SHARE: f64 = 0.8;

/// Part of an iteration that took longer than its median over the run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cause {
    /// Name of a stage, `lateness`, `unattributed`, [`REST_OF_UNATTRIBUTED`] or [`BOTH_DIRECTIONS`].
    pub name: Name,
    /// Duration of the part in this iteration, seconds.
    pub value: f64,
    /// Median of the part over the run, seconds.
    pub median: f64,
}

impl Cause {
    /// Returns the time by which the part took longer than its median, seconds.
    pub fn excess(&self) -> f64 {
        self.value - self.median
    }
}

/// Returns the causes of a slow iteration, which took `total` seconds in a run with the median `median`. They are the
/// parts with the largest excess over their medians, the largest first, until they explain 80 % of the excess of the
/// total. `parts` must not overlap, because the same time would then count twice. Empty if the iteration took less than
/// 1.05 times the median.
pub fn causes(total: f64, median: f64, parts: impl IntoIterator<Item = Cause>) -> Vec<Cause> {
    if total < USUAL_RATIOS.end * median {
        return Vec::new();
    }
    let excess_to_explain = MIN_EXPLAINED_SHARE * (total - median);
    let mut slow_parts: Vec<Cause> = parts.into_iter().filter(|part| part.excess() > 0.0).collect();
    slow_parts.sort_by(|a, b| b.excess().total_cmp(&a.excess()));
    let mut explained_excess = 0.0;
    slow_parts
        .into_iter()
        .take_while(|cause| {
            let is_needed = explained_excess < excess_to_explain;
            explained_excess += cause.excess();
            is_needed
        })
        .collect()
}

/// Returns the time that both directions of the network take together: the total minus the other stages and the
/// unattributed time.
pub fn both_ways(total: f64, others: impl Iterator<Item = f64>, unattributed: f64) -> f64 {
    (total - others.sum::<f64>() - unattributed).max(0.0)
}

/// Durations of an iteration and its parts, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IterationTimes<'a> {
    /// Duration from the intended start to the end.
    pub total: Option<f64>,
    /// Durations in the order of the stages.
    pub stages: &'a [(Name, f64)],
    /// Part of the total that does not belong to a stage.
    pub unattributed: Option<f64>,
    /// Time from the intended start to the real start: a part of `unattributed`.
    pub lateness: Option<f64>,
    /// Sum of the durations of upload and download, if only the sum is known.
    pub both_ways: Option<f64>,
}

/// Medians of a run's nodes by their names, seconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Medians(pub Vec<(Name, f64)>);

impl Medians {
    /// Returns the median of a node; `None` if the run has no values of it.
    pub fn median(&self, name: &str) -> Option<f64> {
        self.0.iter().find(|(node, _)| node == name).map(|(_, median)| *median)
    }

    /// Returns the sum of the medians of `upload` and `download`. If neither has a median, because no delay is known,
    /// the sum is computed from the medians of the total, of the other stages and of the unattributed time.
    pub fn both_ways(&self) -> Option<f64> {
        let medians = [stage::UPLOAD, stage::DOWNLOAD].into_iter().filter_map(|name| self.median(&name));
        let medians: Vec<f64> = medians.collect();
        if !medians.is_empty() {
            return Some(medians.iter().sum());
        }
        // `upload` and `download` have no median here, so these are the other stages.
        let others = stage::ORDER.into_iter().filter_map(|name| self.median(&name));
        Some(both_ways(self.median(&stage::TOTAL)?, others, self.median(&stage::UNATTRIBUTED)?))
    }

    /// Returns the ratio of a total to the median total of the run; `None` if the total or the median is not known, or
    /// the median is 0.
    pub fn ratio_to_median(&self, total: Option<f64>) -> Option<f64> {
        let median = self.median(&stage::TOTAL).filter(|median| *median > 0.0)?;
        Some(total? / median)
    }

    /// Returns the causes of a slow iteration. The unattributed time is a candidate like any stage. If starts are late,
    /// the lateness is a separate candidate, and [`REST_OF_UNATTRIBUTED`] replaces the unattributed time. If only the
    /// sum of upload and download is known, the sum replaces both stages.
    pub fn causes(&self, times: &IterationTimes<'_>) -> Vec<Cause> {
        let Some((total, median)) = times.total.zip(self.median(&stage::TOTAL)) else { return Vec::new() };
        let lateness_name = Name::from_static(LATENESS);
        let median_lateness = self.median(&lateness_name).unwrap_or(0.0);
        let cause = |name: &Name, value, median: Option<f64>| {
            median.map(|median| Cause { name: name.clone(), value, median })
        };
        let is_separate = |name: &Name| times.both_ways.is_none() || !stage::is_one_way(name);
        let stages = times.stages.iter().filter(|(name, _)| is_separate(name));
        let stages = stages.filter_map(|(name, value)| cause(name, *value, self.median(name)));
        let lateness = times.lateness.and_then(|value| cause(&lateness_name, value, Some(median_lateness)));
        let unattributed = times.unattributed.and_then(|value| {
            let median = self.median(&stage::UNATTRIBUTED);
            let value_lateness = times.lateness.unwrap_or(0.0);
            let without_lateness = |value: f64, lateness: f64| (value - lateness).max(0.0);
            let has_lateness = value_lateness > 0.0 || median_lateness > 0.0;
            let name =
                if has_lateness { Name::from_static(REST_OF_UNATTRIBUTED) } else { stage::UNATTRIBUTED };
            cause(
                &name,
                without_lateness(value, value_lateness),
                median.map(|median| without_lateness(median, median_lateness)),
            )
        });
        let network = times
            .both_ways
            .and_then(|value| cause(&Name::from_static(BOTH_DIRECTIONS), value, self.both_ways()));
        causes(total, median, stages.chain(lateness).chain(unattributed).chain(network))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(name: &'static str, value: f64, median: f64) -> Cause {
        Cause { name: Name::from_static(name), value, median }
    }

    fn names(causes: &[Cause]) -> Vec<&str> {
        causes.iter().map(|cause| cause.name.as_str()).collect()
    }

    #[test]
    fn causes_explain_most_of_excess() {
        let parts = [
            part("sensing", 0.021, 0.020),
            part("lateness", 0.124, 0.002),
            part("inference", 0.231, 0.012),
            part("download", 0.040, 0.021),
        ];
        let found = causes(0.42, 0.055, parts);
        assert_eq!(names(&found), ["inference", "lateness"]);
    }

    #[test]
    fn single_cause_suffices_if_it_explains_most() {
        let parts = [part("upload", 0.0204, 0.0063), part("inference", 0.0121, 0.0105)];
        assert_eq!(names(&causes(0.0335, 0.0178, parts)), ["upload"]);
    }

    #[test]
    fn iteration_within_usual_variation_has_no_causes() {
        let parts = || [part("upload", 0.010, 0.005), part("inference", 0.005, 0.015)];
        assert_eq!(causes(0.015, 0.020, parts()), []);
        assert_eq!(causes(0.020, 0.020, parts()), []);
        assert_eq!(causes(0.0209, 0.020, parts()), [], "4.5 % are the usual variation");
        assert_eq!(names(&causes(0.0211, 0.020, parts())), ["upload"]);
    }

    #[test]
    fn faster_parts_are_no_causes() {
        let parts = [part("upload", 0.010, 0.011), part("inference", 0.012, 0.010)];
        assert_eq!(names(&causes(0.1, 0.02, parts)), ["inference"]);
    }

    fn medians(medians: &[(&'static str, f64)]) -> Medians {
        Medians(medians.iter().map(|(name, median)| (Name::from_static(name), *median)).collect())
    }

    fn names_and_excesses(causes: &[Cause]) -> Vec<(&str, f64)> {
        let milliseconds = |seconds: f64| (seconds * 1e3).round();
        causes.iter().map(|cause| (cause.name.as_str(), milliseconds(cause.excess()))).collect()
    }

    #[test]
    fn lateness_is_separated_from_unattributed_time() {
        let run =
            medians(&[("total", 0.055), ("inference", 0.012), ("unattributed", 0.004), ("lateness", 0.002)]);
        let stages = [(stage::INFERENCE, 0.231)];
        let times = IterationTimes {
            total: Some(0.4),
            stages: &stages,
            lateness: Some(0.124),
            unattributed: Some(0.127),
            both_ways: None,
        };
        assert_eq!(names_and_excesses(&run.causes(&times)), [("inference", 219.0), ("lateness", 122.0)]);
    }

    #[test]
    fn sum_of_both_directions_replaces_each_direction() {
        let run = medians(&[("total", 0.1), ("upload", 0.02), ("download", 0.01), ("unattributed", 0.0)]);
        let stages = [(stage::UPLOAD, 0.3)];
        let times = IterationTimes {
            total: Some(0.45),
            stages: &stages,
            lateness: None,
            unattributed: Some(0.001),
            both_ways: Some(0.38),
        };
        assert_eq!(names_and_excesses(&run.causes(&times)), [(BOTH_DIRECTIONS, 350.0)]);
    }
}
