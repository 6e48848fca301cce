//! Causes of an iteration's slowness, by comparison with its run.

use peernet_analysis::rows::LATENESS;
use peernet_analysis::slowness::{self, Cause};
use peernet_logger::{Name, stage};

use crate::figures::Figures;
use crate::types::BOTH_WAYS;

/// Durations of an iteration and its parts, seconds.
pub(super) struct Times<'a> {
    pub total: Option<f64>,
    /// In the order of the stages.
    pub stages: &'a [(Name, f64)],
    /// From the intended start to the real one: a part of `unattributed`.
    pub lateness: Option<f64>,
    pub unattributed: Option<f64>,
    /// Both directions of the network, if they are only known together.
    pub both_ways: Option<f64>,
}

/// The figures of a run, with which its iterations are compared.
pub(super) struct Comparison(pub(super) Vec<(Name, Figures)>);

impl Comparison {
    fn median(&self, name: &str) -> Option<f64> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, figures)| figures.p50)
    }

    /// Returns the median of `upload` and `download` together. If neither is ever known, it is the rest of the total's median after
    /// the other parts.
    fn both_ways(&self) -> Option<f64> {
        let known = [stage::UPLOAD, stage::DOWNLOAD].into_iter().filter_map(|name| self.median(&name));
        let known: Vec<f64> = known.collect();
        if !known.is_empty() {
            return Some(known.iter().sum());
        }
        let others: f64 = stage::ORDER.iter().filter_map(|name| self.median(name)).sum();
        Some((self.median(&stage::TOTAL)? - others - self.median(&stage::UNATTRIBUTED)?).max(0.0))
    }

    pub(super) fn factor(&self, total: Option<f64>) -> Option<f64> {
        let median = self.median(&stage::TOTAL).filter(|median| *median > 0.0)?;
        Some(total? / median)
    }

    /// Returns the causes of an iteration's slowness.
    ///
    /// The unattributed time is a candidate like any stage, without the late start if that is known. Both directions of the network
    /// replace each of them if they are only known together.
    pub(super) fn causes(&self, times: &Times<'_>) -> Vec<Cause> {
        let Some((total, median)) = times.total.zip(self.median(&stage::TOTAL)) else { return Vec::new() };
        let late = Name::from_static(LATENESS);
        let usually_late = self.median(&late).unwrap_or(0.0);
        let cause = |name: &Name, value, median: Option<f64>| {
            median.map(|median| Cause { name: name.clone(), value, median })
        };
        let is_part =
            |name: &Name| times.both_ways.is_none() || ![stage::UPLOAD, stage::DOWNLOAD].contains(name);
        let stages = times.stages.iter().filter(|(name, _)| is_part(name));
        let stages = stages.filter_map(|(name, value)| cause(name, *value, self.median(name)));
        let start = times.lateness.and_then(|value| cause(&late, value, Some(usually_late)));
        let rest = times.unattributed.and_then(|value| {
            let median = self.median(&stage::UNATTRIBUTED);
            let on_time = |value: f64, late: f64| (value - late).max(0.0);
            cause(
                &stage::UNATTRIBUTED,
                on_time(value, times.lateness.unwrap_or(0.0)),
                median.map(|median| on_time(median, usually_late)),
            )
        });
        let network =
            times.both_ways.and_then(|value| cause(&Name::from_static(BOTH_WAYS), value, self.both_ways()));
        slowness::causes(total, median, stages.chain(start).chain(rest).chain(network))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn medians(medians: &[(&'static str, f64)]) -> Comparison {
        let figures =
            |p50| Figures { count: 100, mean: p50, std: None, min: p50, p50, p95: None, p99: None, max: p50 };
        Comparison(medians.iter().map(|(name, p50)| (Name::from_static(name), figures(*p50))).collect())
    }

    fn named(causes: &[Cause]) -> Vec<(&str, f64)> {
        let milliseconds = |seconds: f64| (seconds * 1e3).round();
        causes.iter().map(|cause| (cause.name.as_str(), milliseconds(cause.excess()))).collect()
    }

    #[test]
    fn late_start_is_separated_from_unattributed_time() {
        let run =
            medians(&[("total", 0.055), ("inference", 0.012), ("unattributed", 0.004), ("lateness", 0.002)]);
        let stages = [(stage::INFERENCE, 0.231)];
        let times = Times {
            total: Some(0.4),
            stages: &stages,
            lateness: Some(0.124),
            unattributed: Some(0.127),
            both_ways: None,
        };
        assert_eq!(named(&run.causes(&times)), [("inference", 219.0), ("lateness", 122.0)]);
    }

    #[test]
    fn sum_of_both_directions_replaces_each() {
        let run = medians(&[("total", 0.1), ("upload", 0.02), ("download", 0.01), ("unattributed", 0.0)]);
        let stages = [(stage::UPLOAD, 0.3)];
        let times = Times {
            total: Some(0.45),
            stages: &stages,
            lateness: None,
            unattributed: Some(0.001),
            both_ways: Some(0.38),
        };
        assert_eq!(named(&run.causes(&times)), [(BOTH_WAYS, 350.0)]);
    }
}
