//! Means of stages that add up to the mean of the total.

use peernet_aggregator::Window;
use peernet_analysis::slowness;
use peernet_figures::drawing::{StageBar, StagePart};
use peernet_figures::scale::Scale;
use peernet_logger::{Name, stage};
use peernet_statistics::number::{duration, figure};
use peernet_store::{DelayAccuracy, IterationRow, QuantityStatistics, StageStatistics};

use crate::look;
use crate::picture::Picture;

/// The stages of a window or run, and the unattributed time.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Stack {
    /// Parts in the order of [`look::STACK`].
    pub parts: Vec<StagePart>,
    /// Figures of `total`.
    pub total: Option<QuantityStatistics>,
}

impl Stack {
    /// Returns the stack of a live window.
    pub(crate) fn of_window(window: &Window) -> Self {
        let was_sent = window.bounds.iter().any(|bound| bound.verdicts.iter().any(|(_, count)| *count > 0));
        Self::new(was_sent, |name| window.value(name).copied()).with_bounds(&window.bounds)
    }

    /// Returns the stack of a stored run.
    pub(crate) fn of_run(stages: &[StageStatistics], bounds: &[DelayAccuracy]) -> Self {
        let find = |name: &str| stages.iter().find(|stage| stage.stage == *name).map(|stage| stage.figures);
        Self::new(!bounds.is_empty(), find).with_bounds(bounds)
    }

    /// Adds the error bars of the one-way delays.
    fn with_bounds(mut self, bounds: &[DelayAccuracy]) -> Self {
        for bound in bounds {
            if let Some(part) = self.parts.iter_mut().find(|part| part.name == bound.stage.as_str()) {
                part.bound = bound.half_width.map(|width| width.p50).filter(|width| *width > 0.0);
            }
        }
        self
    }

    fn new(was_sent: bool, statistics_of: impl Fn(&str) -> Option<QuantityStatistics>) -> Self {
        let parts = parts(was_sent, |name| statistics_of(name).map(|figures| (figures.count, figures.mean)));
        Self { parts, total: statistics_of("total") }
    }

    /// Returns the stack of one iteration. If a direction of the network is unknown, the stack has the sum of both directions instead.
    pub(crate) fn of_iteration(row: &IterationRow) -> Self {
        let part = |(name, seconds): &(Name, f64)| StagePart {
            name: name.to_string(),
            seconds: *seconds,
            bound: None,
        };
        // The sum of both directions contains a direction that is known by itself, so that direction is left out.
        let is_separate =
            |(name, _): &&(Name, f64)| row.both_ways.is_none() || !look::is_one_way(name.as_str());
        let mut parts: Vec<StagePart> = row.stages.iter().filter(is_separate).map(part).collect();
        if let Some(seconds) = row.both_ways {
            let index = look::STACK
                .iter()
                .take_while(|name| stage::UPLOAD != **name)
                .filter(|name| parts.iter().any(|part| part.name == **name))
                .count();
            parts.insert(index, StagePart { name: look::NETWORK.to_owned(), seconds, bound: None });
        }
        let unattributed =
            row.total.map_or(0.0, |total| total - parts.iter().map(|part| part.seconds).sum::<f64>());
        if unattributed > 0.0 {
            parts.push(StagePart { name: "unattributed".to_owned(), seconds: unattributed, bound: None });
        }
        Self { parts, total: None }
    }

    /// Returns the position of the end of the bar, ms.
    pub(crate) fn end_ms(&self) -> f64 {
        self.parts.iter().map(|part| part.seconds).sum::<f64>() * 1e3
    }

    /// Returns the stack as a bar with its whiskers.
    pub(crate) fn bar(
        &self,
        class: &'static str,
        quantiles: (Option<f64>, Option<f64>),
        scale: Scale,
    ) -> Picture {
        let bar = StageBar { quantiles: quantiles.into(), ..StageBar::new(&self.parts, scale) };
        Picture::of_items(&bar.items(), class, &self.finding(quantiles))
    }

    /// Returns the stack as a bar that fills its panel.
    pub(crate) fn full_width_bar(&self, class: &'static str) -> Picture {
        Picture::of_items(&StageBar::whole(&self.parts).items(), class, &self.finding((None, None)))
    }

    /// Returns the description of the bar in words.
    pub(crate) fn finding(&self, (p95, p99): (Option<f64>, Option<f64>)) -> String {
        let Some(total) = &self.total else { return "no successful iteration in this time".to_owned() };
        let mut text = format!("Median {}", duration(total.p50));
        for (name, quantile) in [("p95", p95), ("p99", p99)] {
            if let Some(seconds) = quantile {
                text.push_str(&format!(", {name} {}", duration(seconds)));
            }
        }
        let mut largest: Vec<&StagePart> = self.parts.iter().collect();
        largest.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        let names = largest
            .iter()
            .take(3)
            .map(|part| format!("{} {}\u{202f}ms", part.name, figure(part.seconds * 1e3)));
        format!("{text}. Largest stages: {}.", names.collect::<Vec<_>>().join(", "))
    }
}

/// Returns the parts of the mean of the total, in the order of [`look::STACK`]; empty without a total. `mean_of` returns the number of
/// samples of a node and their mean in seconds. `was_sent` is `true` if anything was sent to another host.
pub(crate) fn parts(was_sent: bool, mean_of: impl Fn(&str) -> Option<(u64, f64)>) -> Vec<StagePart> {
    let Some((count, total)) = mean_of("total") else { return Vec::new() };
    let mut unattributed = total;
    // Without a relation between the clocks neither direction has a value. The sum of both directions needs no clock relation.
    let network = both_ways(&mean_of, was_sent);
    let mut parts = Vec::with_capacity(look::STACK.len());
    let mut network_index = 0;
    for name in stage::ORDER.iter().map(|name| name.as_str()) {
        if let Some(seconds) = mean_of(name).map(|count_and_mean| mean_per_iteration(count_and_mean, count)) {
            unattributed -= seconds;
            parts.push(StagePart { name: name.to_owned(), seconds, bound: None });
        }
        if name == "send-queue" {
            network_index = parts.len();
        }
    }
    if let Some(network) = network {
        parts.insert(
            network_index,
            StagePart { name: look::NETWORK.to_owned(), seconds: network, bound: None },
        );
        unattributed -= network;
    }
    if unattributed > 0.0 {
        parts.push(StagePart { name: "unattributed".to_owned(), seconds: unattributed, bound: None });
    }
    parts
}

/// Returns the mean time of a stage per iteration, from the count and the mean of the stage and the number of iterations. Iterations
/// without the stage count as zero, so that the sum of all stages stays exact.
pub(super) fn mean_per_iteration((count, mean): (u64, f64), iterations: u64) -> f64 {
    mean * count as f64 / iterations.max(1) as f64
}

/// Returns the mean of the sum of both directions, seconds, if neither direction is known by itself. `None` if a direction is known or
/// nothing was sent.
fn both_ways(mean_of: impl Fn(&str) -> Option<(u64, f64)>, was_sent: bool) -> Option<f64> {
    let (count, total) = mean_of(&stage::TOTAL)?;
    if !was_sent || mean_of(&stage::UPLOAD).is_some() || mean_of(&stage::DOWNLOAD).is_some() {
        return None;
    }
    let stage_means = stage::ORDER
        .into_iter()
        .filter_map(|name| mean_of(&name))
        .map(|count_and_mean| mean_per_iteration(count_and_mean, count));
    let network = slowness::both_ways(total, stage_means, mean_of(&stage::UNATTRIBUTED)?.1);
    Some(network).filter(|network| *network > 0.0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn figures(mean: f64, count: u64) -> QuantityStatistics {
        QuantityStatistics { count, mean, std: None, min: mean, p50: mean, p95: None, p99: None, max: mean }
    }

    #[test]
    fn rest_of_total_is_shown_as_unattributed() {
        let stack = Stack::new(false, |name| match name {
            "total" => Some(figures(0.020, 50)),
            "sensing" => Some(figures(0.005, 50)),
            "upload" => Some(figures(0.010, 50)),
            _ => None,
        });
        let names: Vec<_> = stack.parts.iter().map(|part| part.name.as_str()).collect();
        assert_eq!(names, ["sensing", "upload", "unattributed"]);
        assert!((stack.end_ms() - 20.0).abs() < 1e-9);
    }

    #[test]
    fn unknown_directions_are_shown_as_their_sum() {
        let stack = Stack::new(true, |name| match name {
            "total" => Some(figures(0.020, 50)),
            "sensing" => Some(figures(0.004, 50)),
            "inference" => Some(figures(0.003, 50)),
            "unattributed" => Some(figures(0.001, 50)),
            _ => None,
        });
        let names: Vec<_> = stack.parts.iter().map(|part| part.name.as_str()).collect();
        assert_eq!(names, ["sensing", look::NETWORK, "inference", "unattributed"]);
        assert!((stack.parts[1].seconds - 0.012).abs() < 1e-12);
        assert!(stack.finding((None, None)).contains("Largest stages: upload + download 12.0\u{202f}ms"));
    }

    #[test]
    fn bar_of_stepped_iteration_has_directions_once() {
        let mut row = crate::tests::samples::iteration().row;
        row.total = Some(1.200);
        row.stages = vec![(stage::SENSING, 0.002), (stage::UPLOAD, 0.010), (stage::INFERENCE, 0.0002)];
        (row.unattributed, row.both_ways) = (Some(0.0118), Some(1.186));
        let stack = Stack::of_iteration(&row);
        let names: Vec<_> = stack.parts.iter().map(|part| part.name.as_str()).collect();
        assert_eq!(names, ["sensing", look::NETWORK, "inference", "unattributed"]);
        assert!((stack.end_ms() - 1_200.0).abs() < 1e-6 && (stack.parts[3].seconds - 0.0118).abs() < 1e-9);
    }

    #[test]
    fn known_direction_needs_no_sum() {
        let with_upload =
            |name: &str| matches!(name, "total" | "upload" | "unattributed").then_some((9, 0.01));
        assert_eq!(both_ways(with_upload, true), None);
        let without_directions = |name: &str| matches!(name, "total" | "unattributed").then_some((9, 0.01));
        assert_eq!(both_ways(without_directions, false), None);
    }

    #[test]
    fn stack_without_total_is_empty() {
        assert_eq!(Stack::new(true, |name| (name != "total").then(|| figures(1.0, 1))), Stack::default());
    }

    proptest! {
        #[test]
        fn parts_add_up_to_total(
            means in proptest::collection::vec((0.0f64..0.1, 1u64..100), stage::ORDER.len()),
            rest in 0.0f64..0.01,
        ) {
            let sum: f64 = means.iter().map(|(mean, count)| mean * *count as f64 / 100.0).sum();
            let stack = Stack::new(false, |name| {
                if name == "total" {
                    return Some(figures(sum + rest, 100));
                }
                let index = stage::ORDER.iter().position(|stage| stage == name)?;
                Some(figures(means[index].0, means[index].1))
            });
            prop_assert!((stack.end_ms() - (sum + rest) * 1e3).abs() < 1e-6);
        }
    }
}
