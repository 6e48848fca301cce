//! Two quantities of each iteration against each other, with the distribution of each at the side of the plot.

use askama::Template;
use peernet_figures::drawing::would_squeeze;
use peernet_statistics::Summary;

use super::cloud::Cloud;
use super::{Axis, Horizontal, Percent, pen};

/// Bins of a distribution between the ends of the values.
const BINS: u32 = 40;
/// Quantile above which values are only counted, so that one straggler does not compress all others into a corner.
const ENDS_AT: f64 = 0.99;
/// Share of its length by which the axis extends beyond that quantile. A largest value that is at most [`WORTH`] times this length is not
/// a straggler.
const MARGIN: f64 = 0.1;
const WORTH: f64 = 1.5;
/// Margin on both sides of values that lie far from zero, as a share of their range.
const ROOM: f64 = 0.05;
/// Ends within this share of each other are one end.
const ROUNDING: f64 = 1e-9;
/// Smallest value, as a share of the largest, that is not taken as zero. Without this limit such a value would make the axis logarithmic.
const NOTHING: f64 = 1e-12;
/// Points of a line that is drawn: on a logarithmic axis a straight line is a curve.
const STEPS: u32 = 64;

/// An axis that several plots share.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LengthAxis {
    unit: String,
    per_si: f64,
    on: Horizontal,
    /// Between the ends of the values, as shown.
    edges: Vec<f64>,
}

impl LengthAxis {
    /// Returns an axis from zero to the largest value, or to a little above the largest 99th percentile where stragglers lie far beyond
    /// it, shown as `per_si` times the measured value. The axis begins at the smallest value where zero would compress all others, where
    /// the values span more than a decade, and where the smallest is negative. `None` without values.
    pub(crate) fn of<'a>(all: impl Iterator<Item = &'a Summary>, unit: &str, per_si: f64) -> Option<Self> {
        let ends = |known: &Summary| {
            let (typical, most) = (known.quantile(ENDS_AT)?, known.moments.max);
            let least = known.moments.min;
            let lo = if least.abs() < typical.abs() * NOTHING { 0.0 } else { least };
            let beyond = |share: f64| Horizontal::of([lo, typical].into_iter()).between(lo, typical, share);
            let hi = if most <= beyond(WORTH) { most } else { beyond(1.0 + MARGIN).min(most) };
            Some((lo * per_si, hi * per_si))
        };
        let (lo, hi) = all.filter_map(ends).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        let hi = if hi > lo { hi } else { lo + lo.abs().max(1e-6) * 0.01 };
        let room = (hi - lo) * ROOM;
        let on = if lo < 0.0 {
            Horizontal::around(lo, hi.max(0.0), 5)
        } else if would_squeeze(lo, hi) {
            Horizontal::around(lo - room, hi + room, 5)
        } else {
            Horizontal::of([lo, hi].into_iter())
        };
        let edges = (0..=BINS).map(|at| on.between(lo, hi, f64::from(at) / f64::from(BINS))).collect();
        Some(Self { unit: unit.to_owned(), per_si, on, edges })
    }

    /// Returns the unit, and whether the axis is logarithmic.
    fn title(&self) -> String {
        let scale = if self.on.is_logarithmic() { ", logarithmic" } else { "" };
        format!("{}{scale}", self.unit)
    }

    /// Returns the largest value that has a place on the axis, in the unit that is measured.
    fn end(&self) -> f64 {
        self.edges.last().map_or(f64::INFINITY, |end| (end + end.abs() * ROUNDING) / self.per_si)
    }

    /// Returns the position of a value as a share of the axis; `None` beyond its end.
    fn at(&self, value: f64) -> Option<f64> {
        (value <= self.end()).then(|| self.on.at(value * self.per_si).0 / 100.0)
    }

    /// Returns the number of values beyond its end.
    pub(crate) fn beyond(&self, values: &Summary) -> u64 {
        let inside = values.fraction_below(self.end()).unwrap_or(1.0);
        ((1.0 - inside) * values.count() as f64).round() as u64
    }

    /// Begin, end and height of the bars of a distribution, percent; the fullest bin is as high as there is room.
    fn bars(&self, values: &Summary) -> Vec<[f64; 3]> {
        let mut edges: Vec<f64> = self.edges.iter().map(|edge| edge / self.per_si).collect();
        if let Some(end) = edges.last_mut().filter(|_| self.end() >= values.moments.max) {
            *end = f64::INFINITY;
        }
        let counts = values.histogram(&edges);
        let most = counts.iter().copied().fold(0.0, f64::max);
        let bars = self.edges.windows(2).zip(&counts).filter(|(_, size)| **size > 0.0);
        bars.map(|(edges, size)| [self.on.at(edges[0]).0, self.on.at(edges[1]).0, size / most * 100.0])
            .collect()
    }
}

/// Values of a plot.
pub(crate) struct LengthValues<'a> {
    /// A sample of the iterations: both quantities as measured.
    pub points: &'a [(f64, f64)],
    /// Values of all iterations.
    pub x: &'a Summary,
    pub y: &'a Summary,
    /// Intercept and slope of a line through them.
    pub line: Option<(f64, f64)>,
}

/// Points with the distributions of both quantities: above and to the right.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/lengths.html")]
pub(crate) struct LengthPlot {
    look: &'static str,
    label: String,
    units: (String, String),
    grid: Vec<Percent>,
    rows: Vec<(Percent, String)>,
    columns: Axis,
    cloud: Cloud,
    line: Option<String>,
    /// Bars above the plot: left, width, top, height.
    above: Vec<[Percent; 4]>,
    /// Bars to the right of the plot: top, height, width.
    beside: Vec<[Percent; 3]>,
}

impl askama::filters::HtmlSafe for LengthPlot {}

impl LengthPlot {
    /// Draws these values on axes; `label` describes them in words.
    pub(crate) fn new(
        look: &'static str,
        label: String,
        values: &LengthValues<'_>,
        (x, y): (&LengthAxis, &LengthAxis),
    ) -> Self {
        let place = |(across, up): (f64, f64)| Some((x.at(across)?, 1.0 - y.at(up)?));
        let points: Vec<_> = values.points.iter().filter_map(|point| place(*point)).collect();
        let line = values.line.map(|(intercept, slope)| {
            let ends = (values.x.moments.min, values.x.moments.max.min(x.end()));
            let steps = (0..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
            let course = steps.map(|step| x.on.between(ends.0, ends.1, step));
            pen::line(course.map(|across| place((across, intercept + slope * across))))
        });
        let above = x
            .bars(values.x)
            .into_iter()
            .map(|[from, to, height]| [from, to - from, 100.0 - height, height].map(Percent));
        let beside = y.bars(values.y).into_iter();
        Self {
            look,
            label,
            units: (x.title(), y.title()),
            grid: x.on.ticks().into_iter().map(|(at, _)| at).collect(),
            rows: y.on.ticks().into_iter().map(|(at, text)| (Percent(100.0 - at.0), text)).collect(),
            columns: Axis::below(x.on.ticks()),
            cloud: Cloud::of(&points),
            line,
            above: above.collect(),
            beside: beside.map(|[from, to, width]| [100.0 - to, to - from, width].map(Percent)).collect(),
        }
    }

    /// Returns whether the points are counted into cells.
    pub(crate) fn is_counted(&self) -> bool {
        !self.cloud.cells.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(values: impl Iterator<Item = f64>) -> Summary {
        let mut summary = Summary::default();
        values.for_each(|value| summary.record(value));
        summary
    }

    /// Tokens from 50 on and the seconds they take.
    fn talk(count: u32, seconds: f64) -> Vec<(f64, f64)> {
        (0..count).map(|n| (f64::from(50 + n % 300), seconds * f64::from(100 + n % 300))).collect()
    }

    fn plot(points: &[(f64, f64)], line: Option<(f64, f64)>) -> (LengthPlot, LengthAxis) {
        let (x, y) = (summary(points.iter().map(|it| it.0)), summary(points.iter().map(|it| it.1)));
        let across = LengthAxis::of([&x].into_iter(), "tokens", 1.0).expect("values");
        let up = LengthAxis::of([&y].into_iter(), "ms", 1e3).expect("values");
        let values = LengthValues { points, x: &x, y: &y, line };
        (LengthPlot::new("inference", "A".to_owned(), &values, (&across, &up)), up)
    }

    #[test]
    fn points_lie_where_their_values_are_and_distributions_beside_them() {
        let (plot, _) = plot(&talk(300, 1e-3), Some((0.05, 1e-3)));
        let html = plot.to_string();
        assert_eq!((html.matches('M').count(), html.matches("h0").count()), (301, 300), "dots and a line");
        assert!(plot.above.len() == 40 && plot.beside.len() == 40, "{plot:?}");
        assert!(plot.above.iter().all(|[_, _, top, height]| (top.0 + height.0 - 100.0).abs() < 1e-9));
        // 50 of 400 tokens and 100 of 450 ms.
        let first = plot.cloud.dots.as_deref().and_then(|path| path.split('h').next()).expect("a dot");
        assert_eq!(first, "M125.0 800.0", "{html}");
        assert!(!plot.is_counted() && html.contains("aria-label=\"A\""), "{html}");
    }

    #[test]
    fn many_points_are_cells() {
        let (plot, _) = plot(&talk(500, 1e-3), None);
        assert!(plot.is_counted() && plot.to_string().contains("fill-opacity"), "{plot:?}");
    }

    #[test]
    fn a_straggler_is_counted_and_not_drawn() {
        let mut points = talk(300, 1e-3);
        points.push((60.0, 30.0));
        let (plot, up) = plot(&points, None);
        assert_eq!(plot.cloud.dots.expect("dots").matches('M').count(), 300);
        assert_eq!(up.beyond(&summary(points.iter().map(|it| it.1))), 1);
        assert_eq!(up.beyond(&summary(points.iter().map(|it| it.1).take(300))), 0);
    }

    #[test]
    fn negative_lengths_have_places_of_their_own() {
        let points: Vec<_> = (0..45).map(|n| (f64::from(n % 9) * -5.0, 0.1 + f64::from(n) * 1e-3)).collect();
        let (plot, _) = plot(&points, None);
        let html = plot.to_string();
        let dots = plot.cloud.dots.expect("dots");
        let across: std::collections::BTreeSet<&str> =
            dots.split('M').filter_map(|dot| dot.split(' ').next()).filter(|x| !x.is_empty()).collect();
        assert_eq!(across.len(), 9, "each length has its place: {dots}");
        assert!(across.contains("0.0") && across.contains("1000.0"), "{across:?}");
        assert!(html.contains("\u{2212}40") && plot.above.len() >= 9, "{html}");
        let all = summary([-40.0, -10.0].into_iter());
        let axis = LengthAxis::of([&all].into_iter(), "tokens", 1.0).expect("values");
        assert_eq!((axis.beyond(&all), axis.at(-40.0), axis.at(-10.0)), (0, Some(0.0), Some(0.75)));
    }

    #[test]
    fn what_is_almost_nothing_needs_no_logarithm() {
        let axis = LengthAxis::of([&summary([1e-320, 3.0, 2.0].into_iter())].into_iter(), "tokens", 1.0);
        let axis = axis.expect("values");
        assert_eq!(axis.title(), "tokens");
        assert!(axis.at(1e-320).is_some_and(|at| at < 1e-9) && axis.on.ticks()[0].1 == "0", "{axis:?}");
    }

    #[test]
    fn axes_begin_at_zero_but_where_that_would_squeeze_or_needs_a_logarithm() {
        let begins = |values: &[f64]| {
            let axis = LengthAxis::of([&summary(values.iter().copied())].into_iter(), "B", 1.0);
            let axis = axis.expect("values");
            (axis.on.ticks()[0].1.clone(), axis.title())
        };
        assert_eq!(begins(&[100.0, 200.0]), ("0".to_owned(), "B".to_owned()));
        assert_eq!(begins(&[900.0, 1_000.0]).1, "B");
        assert_ne!(begins(&[900.0, 1_000.0]).0, "0");
        assert_eq!(begins(&[10.0, 2_000.0]), ("10".to_owned(), "B, logarithmic".to_owned()));
        assert_eq!(begins(&[0.0, 2_000.0]).0, "0", "zero has no logarithm");
        assert!(LengthAxis::of([&Summary::default()].into_iter(), "B", 1.0).is_none());
        assert!(LengthAxis::of([&summary([7.0, 7.0].into_iter())].into_iter(), "B", 1.0).is_some());
    }
}
