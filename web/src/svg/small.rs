//! A small histogram beside others on the same axis.

use askama::Template;
use peernet_statistics::Summary;

use super::{Axis, Horizontal, Percent};
use crate::numbers::{SPACE, count, figure};

/// Bins between the ends of the axis.
const BINS: u32 = 48;
/// Above this quantile an axis only counts, so that one straggler does not squeeze all others into a bin.
const ENDS_AT: f64 = 0.99;
/// The axis goes on beyond that quantile by this share of its length.
const MARGIN: f64 = 0.1;
/// Ends within this share of each other are one end.
const ROUNDING: f64 = 1e-9;

/// How one run's samples lie, as tall as its fullest bin.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/small.html")]
pub(crate) struct SmallHistogram {
    label: String,
    grid: Vec<Percent>,
    bars: Vec<[Percent; 4]>,
    median: Option<Percent>,
    axis: Axis,
}

impl askama::filters::HtmlSafe for SmallHistogram {}

/// The axis that small histograms share, ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SmallAxis {
    across: Horizontal,
    edges: Vec<f64>,
}

impl SmallAxis {
    /// From the shortest of all samples, seconds, to a little above the largest 99th percentile; `None` without samples.
    pub(crate) fn of<'a>(all: impl Iterator<Item = &'a Summary>) -> Option<Self> {
        let ends = |known: &Summary| {
            let (lo, typical) = (known.moments.min, known.quantile(ENDS_AT)?);
            Some((lo * 1e3, (typical + (typical - lo) * MARGIN).min(known.moments.max) * 1e3))
        };
        let (lo, hi) = all.filter_map(ends).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        // All samples equal: a bin of a width that can be drawn.
        let hi = if hi > lo { hi } else { lo + lo.abs().max(1e-6) * 0.01 };
        let across = Horizontal::around(lo, hi, 4);
        let edges = (0..=BINS).map(|at| across.between(lo, hi, f64::from(at) / f64::from(BINS)));
        Some(Self { edges: edges.collect(), across })
    }

    /// Whether equal distances are equal factors.
    pub(crate) const fn is_logarithmic(&self) -> bool {
        self.across.is_logarithmic()
    }

    /// How many samples lie beyond its end.
    pub(crate) fn beyond(&self, samples: &Summary) -> u64 {
        let below = self.seconds(samples).last().and_then(|end| samples.fraction_below(*end)).unwrap_or(1.0);
        ((1.0 - below) * samples.count() as f64).round() as u64
    }

    /// The edges, seconds; the last bin takes the largest sample in where the axis ends there.
    fn seconds(&self, samples: &Summary) -> Vec<f64> {
        let mut edges: Vec<f64> = self.edges.iter().map(|edge| edge / 1e3).collect();
        if let Some(end) = edges.last_mut().filter(|end| **end * (1.0 + ROUNDING) >= samples.moments.max) {
            *end = f64::INFINITY;
        }
        edges
    }
}

impl SmallHistogram {
    /// The histogram of these seconds; `of` says in words what it is of.
    pub(crate) fn new(of: &str, samples: &Summary, axis: &SmallAxis) -> Self {
        let at = |milliseconds: f64| axis.across.at(milliseconds);
        let counts = samples.histogram(&axis.seconds(samples));
        let most = counts.iter().copied().fold(0.0, f64::max);
        let bars = axis.edges.windows(2).zip(&counts).filter(|(_, size)| **size > 0.0);
        let bars = bars.map(|(edges, size)| {
            let (x, end, height) = (at(edges[0]), at(edges[1]), size / most * 100.0);
            [x, Percent(end.0 - x.0), Percent(100.0 - height), Percent(height)]
        });
        let median = samples.quantile(0.5).map(|median| median * 1e3);
        let words = median.map_or_else(String::new, |it| format!(": median {}{SPACE}ms", figure(it)));
        let last = axis.edges.last().copied();
        Self {
            label: format!("{of}{words}, {} samples", count(samples.count())),
            grid: axis.across.ticks().into_iter().map(|(x, _)| x).collect(),
            bars: bars.collect(),
            median: median.filter(|it| last.is_some_and(|last| *it <= last)).map(at),
            axis: Axis::below(axis.across.ticks()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(milliseconds: impl Iterator<Item = f64>) -> Summary {
        let mut summary = Summary::default();
        milliseconds.for_each(|value| summary.record(value / 1e3));
        summary
    }

    #[test]
    fn histograms_share_their_axis_and_each_fills_its_height() {
        let (near, far) =
            (summary((0..200).map(|n| 10.0 + f64::from(n) / 200.0)), summary((0..50).map(|_| 14.0)));
        let axis = SmallAxis::of([&near, &far].into_iter()).expect("samples");
        let [near, far] = [&near, &far].map(|one| SmallHistogram::new("A", one, &axis));
        assert_eq!(near.grid, far.grid);
        let end = |plot: &SmallHistogram| plot.bars.last().map_or(0.0, |bar| bar[0].0);
        assert!(end(&near) < 30.0 && end(&far) > 90.0, "{near:?} {far:?}");
        for plot in [near, far] {
            assert!(plot.bars.iter().any(|bar| (bar[3].0 - 100.0).abs() < 1e-9), "{plot:?}");
        }
    }

    #[test]
    fn a_straggler_is_counted_and_does_not_stretch_the_axis() {
        let known = summary((0..1_000).map(|n| if n == 0 { 1_000.0 } else { 10.0 + f64::from(n) / 100.0 }));
        let axis = SmallAxis::of([&known].into_iter()).expect("samples");
        assert!(!axis.is_logarithmic() && (1..=3).contains(&axis.beyond(&known)), "{axis:?}");
        assert_eq!(SmallAxis::of([&Summary::default()].into_iter()), None);
        let equal = summary((0..10).map(|_| 14.0));
        assert_eq!(SmallAxis::of([&equal].into_iter()).expect("samples").beyond(&equal), 0);
    }

    #[test]
    fn runs_that_are_a_decade_apart_lie_on_a_logarithmic_axis() {
        let (fast, slow) = (summary((1..100).map(f64::from)), summary((500..600).map(f64::from)));
        let axis = SmallAxis::of([&fast, &slow].into_iter()).expect("samples");
        assert!(axis.is_logarithmic(), "{axis:?}");
        let equal = summary((0..10).map(|_| 5.0));
        let axis = SmallAxis::of([&equal].into_iter()).expect("samples");
        assert!(!SmallHistogram::new("A", &equal, &axis).bars.is_empty(), "{axis:?}");
    }
}
