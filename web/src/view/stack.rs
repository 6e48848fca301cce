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
        let crossed = window.bounds.iter().any(|bound| bound.verdicts.iter().any(|(_, count)| *count > 0));
        Self::new(crossed, |name| window.value(name).copied()).bounded(&window.bounds)
    }

    /// Returns the stack of a stored run.
    pub(crate) fn of_run(stages: &[StageStatistics], bounds: &[DelayAccuracy]) -> Self {
        let find = |name: &str| stages.iter().find(|stage| stage.stage == *name).map(|stage| stage.figures);
        Self::new(!bounds.is_empty(), find).bounded(bounds)
    }

    /// Adds the error bars of the one-way delays.
    fn bounded(mut self, bounds: &[DelayAccuracy]) -> Self {
        for bound in bounds {
            if let Some(part) = self.parts.iter_mut().find(|part| part.name == bound.stage.as_str()) {
                part.bound = bound.half_width.map(|width| width.p50).filter(|width| *width > 0.0);
            }
        }
        self
    }

    fn new(crossed: bool, of: impl Fn(&str) -> Option<QuantityStatistics>) -> Self {
        let parts = parts(crossed, |name| of(name).map(|figures| (figures.count, figures.mean)));
        Self { parts, total: of("total") }
    }

    /// Returns the stages of an iteration of a list, with both directions of the network where those are not known.
    pub(crate) fn of_iteration(row: &IterationRow) -> Self {
        let part = |(name, seconds): &(Name, f64)| StagePart {
            name: name.to_string(),
            seconds: *seconds,
            bound: None,
        };
        // Where both are known only together, one that is known is a part of that.
        let apart = |(name, _): &&(Name, f64)| row.both_ways.is_none() || !look::is_one_way(name.as_str());
        let mut parts: Vec<StagePart> = row.stages.iter().filter(apart).map(part).collect();
        if let Some(seconds) = row.both_ways {
            let at = look::STACK
                .iter()
                .take_while(|name| stage::UPLOAD != **name)
                .filter(|name| parts.iter().any(|part| part.name == **name))
                .count();
            parts.insert(at, StagePart { name: look::NETWORK.to_owned(), seconds, bound: None });
        }
        let left = row.total.map_or(0.0, |total| total - parts.iter().map(|part| part.seconds).sum::<f64>());
        if left > 0.0 {
            parts.push(StagePart { name: "unattributed".to_owned(), seconds: left, bound: None });
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
    pub(crate) fn whole(&self, class: &'static str) -> Picture {
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

/// Returns the parts of the mean of the total, in the order of [`look::STACK`]; empty without a total. `of` gives the number of samples
/// of a name and their mean in seconds; `sent` is `true` if anything was sent to another host.
pub(crate) fn parts(sent: bool, of: impl Fn(&str) -> Option<(u64, f64)>) -> Vec<StagePart> {
    let Some((count, total)) = of("total") else { return Vec::new() };
    let mut left = total;
    // Without a relation of the clocks neither direction has a value; their sum needs none.
    let network = both_ways(&of, sent);
    let mut parts = Vec::with_capacity(look::STACK.len());
    let mut network_at = 0;
    for name in stage::ORDER.iter().map(|name| name.as_str()) {
        if let Some(seconds) = of(name).map(|known| shared(known, count)) {
            left -= seconds;
            parts.push(StagePart { name: name.to_owned(), seconds, bound: None });
        }
        if name == "send-queue" {
            network_at = parts.len();
        }
    }
    if let Some(network) = network {
        parts.insert(network_at, StagePart { name: look::NETWORK.to_owned(), seconds: network, bound: None });
        left -= network;
    }
    if left > 0.0 {
        parts.push(StagePart { name: "unattributed".to_owned(), seconds: left, bound: None });
    }
    parts
}

/// Returns the mean time of a stage per iteration. A stage that not every iteration had is weighted with its share, so that the
/// sum of all stages stays exact.
pub(super) fn shared((count, mean): (u64, f64), of: u64) -> f64 {
    mean * count as f64 / of.max(1) as f64
}

/// Returns the mean time of both directions together, seconds, where the clocks give neither; `None` when one is known or nothing was
/// sent.
fn both_ways(of: impl Fn(&str) -> Option<(u64, f64)>, sent: bool) -> Option<f64> {
    let (count, total) = of(&stage::TOTAL)?;
    if !sent || of(&stage::UPLOAD).is_some() || of(&stage::DOWNLOAD).is_some() {
        return None;
    }
    let known = stage::ORDER.into_iter().filter_map(|name| of(&name)).map(|known| shared(known, count));
    let network = slowness::both_ways(total, known, of(&stage::UNATTRIBUTED)?.1);
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
    fn what_is_left_over_is_shown_and_not_hidden() {
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
    fn directions_that_cannot_be_told_apart_stand_as_their_exact_sum() {
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
    fn the_bar_of_a_stepped_iteration_holds_both_ways_once() {
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
    fn directions_that_are_known_need_no_sum() {
        let known = |name: &str| matches!(name, "total" | "upload" | "unattributed").then_some((9, 0.01));
        assert_eq!(both_ways(known, true), None);
        let unknown = |name: &str| matches!(name, "total" | "unattributed").then_some((9, 0.01));
        assert_eq!(both_ways(unknown, false), None);
    }

    #[test]
    fn without_a_total_there_is_nothing_to_stack() {
        assert_eq!(Stack::new(true, |name| (name != "total").then(|| figures(1.0, 1))), Stack::default());
    }

    proptest! {
        #[test]
        fn the_parts_add_up_to_the_total(
            means in proptest::collection::vec((0.0f64..0.1, 1u64..100), stage::ORDER.len()),
            rest in 0.0f64..0.01,
        ) {
            let sum: f64 = means.iter().map(|(mean, count)| mean * *count as f64 / 100.0).sum();
            let stack = Stack::new(false, |name| {
                if name == "total" {
                    return Some(figures(sum + rest, 100));
                }
                let at = stage::ORDER.iter().position(|known| known == name)?;
                Some(figures(means[at].0, means[at].1))
            });
            prop_assert!((stack.end_ms() - (sum + rest) * 1e3).abs() < 1e-6);
        }
    }
}
