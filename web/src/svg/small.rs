//! A small histogram; several share one axis.

use askama::Template;
use peernet_statistics::Summary;

use super::{Axis, Horizontal, Percent, shown_in};

/// Bins between the ends of the axis.
const BINS: u32 = 48;
/// Quantile above which values are only counted, so that one straggler does not compress all others into a bin.
const ENDS_AT: f64 = 0.99;
/// Share of its length by which the axis extends beyond that quantile.
const MARGIN: f64 = 0.1;
/// Ends within this share of each other are one end.
const ROUNDING: f64 = 1e-9;

/// Histogram of one run's samples; its fullest bin has the full height.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/small.html")]
pub(crate) struct SmallHistogram {
    look: &'static str,
    label: String,
    grid: Vec<Percent>,
    bars: Vec<[Percent; 4]>,
    /// Left end and width of the interval of the median.
    within: Option<(Percent, Percent)>,
    median: Option<Percent>,
    axis: Axis,
}

impl askama::filters::HtmlSafe for SmallHistogram {}

/// The axis that small histograms of one quantity share.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SmallAxis {
    across: Horizontal,
    /// Edges of the bins, in the shown unit.
    edges: Vec<f64>,
    unit: String,
    /// Factor from an SI value to the shown value.
    factor: f64,
}

impl SmallAxis {
    /// Returns an axis from the smallest of all samples, which are of this SI unit, to a little above the largest 99th percentile; `None`
    /// without samples.
    pub(crate) fn of<'a>(unit: &str, all: impl Iterator<Item = &'a Summary>) -> Option<Self> {
        let (unit, factor) = shown_in(unit);
        let ends = |known: &Summary| {
            let (lo, typical) = (known.moments.min, known.quantile(ENDS_AT)?);
            Some((lo * factor, (typical + (typical - lo) * MARGIN).min(known.moments.max) * factor))
        };
        let (lo, hi) = all.filter_map(ends).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        // All samples equal: a bin of a width that can be drawn.
        let hi = if hi > lo { hi } else { lo + lo.abs().max(1e-6) * 0.01 };
        let across = Horizontal::around(lo, hi, 4);
        let edges = (0..=BINS).map(|at| across.between(lo, hi, f64::from(at) / f64::from(BINS)));
        Some(Self { edges: edges.collect(), across, unit, factor })
    }

    /// Returns the unit of the labels, for people: `ms`, `MB/s, logarithmic`.
    pub(crate) fn unit(&self) -> String {
        // Equal distances are equal factors.
        let logarithmic = if self.across.is_logarithmic() { "logarithmic" } else { "" };
        let parts = [self.unit.as_str(), logarithmic];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
    }

    /// Returns the number of samples beyond its end.
    pub(crate) fn beyond(&self, samples: &Summary) -> u64 {
        let below = self.si(samples).last().and_then(|end| samples.fraction_below(*end)).unwrap_or(1.0);
        ((1.0 - below) * samples.count() as f64).round() as u64
    }

    /// Returns the edges in SI; the last bin takes the largest sample in where the axis ends there.
    fn si(&self, samples: &Summary) -> Vec<f64> {
        let mut edges: Vec<f64> = self.edges.iter().map(|edge| edge / self.factor).collect();
        if let Some(end) = edges.last_mut().filter(|end| **end * (1.0 + ROUNDING) >= samples.moments.max) {
            *end = f64::INFINITY;
        }
        edges
    }

    /// Returns the position of an SI value; values beyond an end are placed at that end.
    fn at(&self, value: f64) -> Percent {
        Percent(self.across.at(value * self.factor).0.clamp(0.0, 100.0))
    }
}

impl SmallHistogram {
    /// Draws a histogram of these samples in the colour of a class; `label` describes it in words. `within` is the interval of their
    /// median, where the median is uncertain.
    pub(crate) fn new(
        look: &'static str,
        label: String,
        samples: &Summary,
        axis: &SmallAxis,
        within: Option<(f64, f64)>,
    ) -> Self {
        let at = |shown: f64| axis.across.at(shown);
        let counts = samples.histogram(&axis.si(samples));
        let most = counts.iter().copied().fold(0.0, f64::max);
        let bars = axis.edges.windows(2).zip(&counts).filter(|(_, size)| **size > 0.0);
        let bars = bars.map(|(edges, size)| {
            let (x, end, height) = (at(edges[0]), at(edges[1]), size / most * 100.0);
            [x, Percent(end.0 - x.0), Percent(100.0 - height), Percent(height)]
        });
        let last = axis.edges.last().copied();
        let is_held = |median: &f64| last.is_some_and(|last| *median * axis.factor <= last);
        Self {
            look,
            label,
            grid: axis.across.ticks().into_iter().map(|(x, _)| x).collect(),
            bars: bars.collect(),
            within: within.map(|(lo, hi)| {
                let (from, to) = (axis.at(lo), axis.at(hi));
                (from, Percent(to.0 - from.0))
            }),
            median: samples.quantile(0.5).filter(is_held).map(|median| axis.at(median)),
            axis: Axis::within(axis.across.ticks()),
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

    fn plot(samples: &Summary, axis: &SmallAxis) -> SmallHistogram {
        SmallHistogram::new("total", String::new(), samples, axis, None)
    }

    #[test]
    fn histograms_share_their_axis_and_each_fills_its_height() {
        let (near, far) =
            (summary((0..200).map(|n| 10.0 + f64::from(n) / 200.0)), summary((0..50).map(|_| 14.0)));
        let axis = SmallAxis::of("s", [&near, &far].into_iter()).expect("samples");
        let [near, far] = [&near, &far].map(|one| plot(one, &axis));
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
        let axis = SmallAxis::of("s", [&known].into_iter()).expect("samples");
        assert!(!axis.across.is_logarithmic() && (1..=3).contains(&axis.beyond(&known)), "{axis:?}");
        assert_eq!(SmallAxis::of("s", [&Summary::default()].into_iter()), None);
        let equal = summary((0..10).map(|_| 14.0));
        assert_eq!(SmallAxis::of("s", [&equal].into_iter()).expect("samples").beyond(&equal), 0);
    }

    #[test]
    fn runs_that_are_a_decade_apart_lie_on_a_logarithmic_axis() {
        let (fast, slow) = (summary((1..100).map(f64::from)), summary((500..600).map(f64::from)));
        let axis = SmallAxis::of("s", [&fast, &slow].into_iter()).expect("samples");
        assert!(axis.across.is_logarithmic(), "{axis:?}");
        let equal = summary((0..10).map(|_| 5.0));
        let axis = SmallAxis::of("s", [&equal].into_iter()).expect("samples");
        assert!(!plot(&equal, &axis).bars.is_empty(), "{axis:?}");
    }

    #[test]
    fn each_quantity_has_its_unit_and_what_is_not_known_has_a_width() {
        let mut rates = Summary::default();
        (80..120).for_each(|n| rates.record(f64::from(n) * 1e6));
        let axis = SmallAxis::of("bit/s", [&rates].into_iter()).expect("samples");
        assert_eq!((axis.unit().as_str(), axis.across.ticks()[0].1.as_str()), ("MB/s", "10"));
        let rates = SmallHistogram::new("upload", String::new(), &rates, &axis, Some((90e6, f64::INFINITY)));
        let (from, width) = rates.within.expect("a bound");
        assert!(from.0 > 10.0 && (from.0 + width.0 - 100.0).abs() < 1e-9, "{rates:?}");
        assert!(rates.to_string().contains("class=\"band\"") && rates.to_string().contains("bin f-upload"));
        assert_eq!(
            SmallAxis::of("", [&summary((0..9).map(f64::from))].into_iter()).expect("samples").unit(),
            ""
        );
    }
}
