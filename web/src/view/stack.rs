//! Means of stages that add up to the mean of the total.

use peernet_aggregator::Window;
use peernet_analysis::rows::Outcome;
use peernet_analysis::stage_split::StageSplit;
use peernet_analysis::unaccounted_time::{IterationDurations, UnaccountedTime};
use peernet_figures::drawing::{StageBar, StagePart};
use peernet_figures::scale::Scale;
use peernet_logger::Name;
use peernet_statistics::number::{DurationFormat, duration, milliseconds};
use peernet_store::{DelayAccuracy, IterationRow, QuantityStatistics, StageStatistics};

use crate::picture::Picture;

/// The mean stages of a window or run, or the stages of one iteration, and the unattributed time.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Stack {
    /// Parts in the order of [`parts`](crate::look::parts).
    pub parts: Vec<StagePart>,
    /// Statistics of `total`; `None` without a successful iteration.
    pub total: Option<QuantityStatistics>,
    /// Means of the stages; empty for one iteration.
    pub split: StageSplit,
}

impl Stack {
    /// Returns the stack of a live window.
    pub(crate) fn of_window(window: &Window) -> Self {
        Self::new(DelayAccuracy::sent_messages(&window.bounds), |name| window.value(name).copied())
            .with_bounds(&window.bounds)
    }

    /// Returns the stack of a stored run.
    pub(crate) fn of_run(stages: &[StageStatistics], bounds: &[DelayAccuracy]) -> Self {
        let find =
            |name: &str| stages.iter().find(|stage| stage.stage == *name).map(|stage| stage.statistics);
        Self::new(DelayAccuracy::sent_messages(bounds), find).with_bounds(bounds)
    }

    /// Returns the format of a table of the parts.
    pub(crate) fn duration_format(&self) -> DurationFormat {
        DurationFormat::for_total(self.total.map(|total| total.mean), self.total.and_then(|total| total.std))
    }

    /// Adds the error bars of the one-way delays.
    fn with_bounds(mut self, bounds: &[DelayAccuracy]) -> Self {
        for bound in bounds {
            if let Some(part) = self.parts.iter_mut().find(|part| part.name == bound.stage.as_str()) {
                part.bound = bound.median_half_width().filter(|width| *width > 0.0);
            }
        }
        self
    }

    /// Creates the stack from the statistics of nodes by name. `sent` has the numbers of messages sent up and down: a
    /// sent message with an unknown delay counts as if it had the mean of the known delays.
    fn new(sent: [u64; 2], statistics_of: impl Fn(&str) -> Option<QuantityStatistics>) -> Self {
        let count_and_mean_of =
            |name: &str| statistics_of(name).map(|statistics| (statistics.count, statistics.mean));
        let split = StageSplit::new(sent, count_and_mean_of);
        Self { parts: bar_parts(split.parts.clone()), total: statistics_of("total"), split }
    }

    /// Returns the stack of one iteration. If upload or download is unknown, the stack has the sum of both in their
    /// place.
    pub(crate) fn of_iteration(row: &IterationRow) -> Self {
        let parts = match durations(row) {
            Some(durations) => UnaccountedTime::parts_of(&durations),
            None => row.stages.clone(),
        };
        Self { parts: bar_parts(parts), ..Self::default() }
    }

    /// Returns the length of the bar, ms: the sum of all parts.
    pub(crate) fn end_ms(&self) -> f64 {
        self.parts.iter().map(|part| part.seconds).sum::<f64>() * 1e3
    }

    /// Returns the stack as a bar with whiskers to the p95 and the p99 in `quantiles`.
    pub(crate) fn bar(
        &self,
        class: &'static str,
        quantiles: (Option<f64>, Option<f64>),
        scale: Scale,
    ) -> Picture {
        let bar = StageBar { quantiles: quantiles.into(), ..StageBar::new(&self.parts, scale) };
        Picture::of_items(&bar.items(), class, &self.description(quantiles))
    }

    /// Returns the stack as a bar that fills its panel.
    pub(crate) fn full_width_bar(&self, class: &'static str) -> Picture {
        let no_quantiles = (None, None);
        let bar = StageBar::full_width(&self.parts);
        Picture::of_items(&bar.items(), class, &self.description(no_quantiles))
    }

    /// Returns the description of the bar in words. The description has the quantiles that are given.
    pub(crate) fn description(&self, (p95, p99): (Option<f64>, Option<f64>)) -> String {
        let Some(total) = &self.total else { return "no successful iteration in this time".to_owned() };
        let mut text = format!("Median {}", duration(total.p50));
        for (name, quantile) in [("p95", p95), ("p99", p99)] {
            if let Some(seconds) = quantile {
                text.push_str(&format!(", {name} {}", duration(seconds)));
            }
        }
        for (index, (name, seconds)) in self.split.longest_stages().into_iter().take(3).enumerate() {
            text.push_str(if index == 0 { ". Longest stages: " } else { ", " });
            text.push_str(&format!("{name} {}\u{202f}ms", milliseconds(*seconds)));
        }
        text + "."
    }
}

/// Returns the durations of an iteration; `None` without a total.
pub(super) fn durations(row: &IterationRow) -> Option<IterationDurations<'_>> {
    Some(IterationDurations {
        total: row.total?,
        stages: &row.stages,
        both_ways: row.both_ways,
        unattributed: row.unattributed,
        has_unknown_delay: row.delays.iter().any(|delay| delay.value.is_none()),
        is_answered: row.outcome == Outcome::Ok,
    })
}

/// Converts parts of a total to parts of a bar without clock bounds.
pub(super) fn bar_parts(parts: Vec<(Name, f64)>) -> Vec<StagePart> {
    let part = |(name, seconds): (Name, f64)| StagePart { name: name.to_string(), seconds, bound: None };
    parts.into_iter().map(part).collect()
}

#[cfg(test)]
mod tests {
    use peernet_logger::stage;
    use proptest::prelude::*;

    use super::*;
    use crate::look;

    fn statistics(mean: f64, count: u64) -> QuantityStatistics {
        QuantityStatistics { count, mean, std: None, min: mean, p50: mean, p95: None, p99: None, max: mean }
    }

    #[test]
    fn unknown_directions_are_shown_as_their_sum() {
        let stack = Stack::new([50; 2], |name| match name {
            "total" => Some(statistics(0.020, 50)),
            "sensing" => Some(statistics(0.004, 50)),
            "inference" => Some(statistics(0.003, 50)),
            "unattributed" => Some(statistics(0.001, 50)),
            _ => None,
        });
        let names: Vec<_> = stack.parts.iter().map(|part| part.name.as_str()).collect();
        assert_eq!(names, ["sensing", look::NETWORK, "inference", "unattributed"]);
        assert!((stack.parts[1].seconds - 0.012).abs() < 1e-12);
        assert!(stack.description((None, None)).contains("Longest stages: upload + download 12.0\u{202f}ms"));
    }

    #[test]
    fn bar_has_sum_of_directions_after_clock_step() {
        let mut row = crate::tests::samples::iteration().row;
        row.total = Some(1.200);
        row.stages = vec![(stage::SENSING, 0.002), (stage::UPLOAD, 0.010), (stage::INFERENCE, 0.0002)];
        (row.unattributed, row.both_ways) = (Some(0.0118), Some(1.186));
        let stack = Stack::of_iteration(&row);
        let names: Vec<_> = stack.parts.iter().map(|part| part.name.as_str()).collect();
        assert_eq!(names, ["sensing", look::NETWORK, "inference", "unattributed"]);
        assert!((stack.end_ms() - 1_200.0).abs() < 1e-6 && (stack.parts[3].seconds - 0.0118).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn parts_add_up_to_total(
            means in proptest::collection::vec((0.0f64..0.1, 1u64..100), stage::ORDER.len()),
            rest in 0.0f64..0.01,
        ) {
            let sum: f64 = means.iter().map(|(mean, count)| mean * *count as f64 / 100.0).sum();
            let stack = Stack::new([0; 2], |name| {
                if name == "total" {
                    return Some(statistics(sum + rest, 100));
                }
                let index = stage::ORDER.iter().position(|stage| stage == name)?;
                Some(statistics(means[index].0, means[index].1))
            });
            prop_assert!((stack.end_ms() - (sum + rest) * 1e3).abs() < 1e-6);
        }
    }
}
