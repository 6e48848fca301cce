//! Figure of latency against the number of edges that share one cloud, with the fairness among these edges.

use peernet_analysis::users::{Curve, UsersLine};
use peernet_statistics::number::fixed;

use super::is_drawable;
use crate::look::{Style, series};
use crate::plot::{Axis, Figure, Height, Item, Key, Marks, Path, Plot, Swatch, Unit};
use crate::scale::{Scale, Tick};

/// Maximum number of curves that a reader can distinguish.
pub const MAX_CURVES: usize = 4;
/// Half the distance between two curves at one number of edges, points.
const HALF_DISTANCE: f64 = 2.0;
/// Half the width of a whisker's cap, and of the dash at the median of one edge, points.
const CAP_HALF_WIDTH: f64 = 1.7;
const DASH_HALF_WIDTH: f64 = 2.7;
/// Radius of a point, and width of lines, points.
const RADIUS: f64 = 1.9;
const LINE_WIDTH: f64 = 0.75;
const WHISKER_WIDTH: f64 = 0.45;
/// Height of the plot of fairness, points.
const FAIRNESS_HEIGHT: f64 = 28.5;
/// The axis of edges is logarithmic if the ratio of the largest to the smallest number of edges is at least this.
const LOGARITHMIC_EDGES_RATIO: f64 = 8.0;
/// The axis of latencies is logarithmic if the ratio of the highest to the lowest latency is more than this.
const LOGARITHMIC_RATIO: f64 = 12.0;
/// Room beyond the values at each end of a linear axis, as a share of their range. On a logarithmic axis, the room is a
/// factor: the ratio of the largest to the smallest value to this power.
const AXIS_MARGIN: f64 = 0.06;

/// Latency and fairness against the number of edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Sharing {
    /// Title of the figure.
    pub title: String,
    /// Unit of the vertical axis: a latency.
    pub unit: Unit,
    /// Curves: at most four.
    pub curves: Vec<SharingCurve>,
    /// Notes below the figure, such as what is left out.
    pub notes: Vec<String>,
}

/// Curve of one configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct SharingCurve {
    /// Name for the legend; if it is empty, there is no entry.
    pub name: String,
    /// Points of the curve, in ascending order of the number of edges.
    pub points: Vec<SharingPoint>,
}

/// Latency and fairness with a certain number of edges at the same time. Latencies are in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct SharingPoint {
    /// Number of edges.
    pub edges: usize,
    /// Median of the totals of all edges.
    pub median: f64,
    /// 95th percentile of all totals; `None` for few values.
    pub p95: Option<f64>,
    /// Median of the totals of each edge.
    pub each: Vec<f64>,
    /// Jain's index of the edges' rates, from 0 to 1; `None` if the rates are not known.
    pub fairness: Option<f64>,
}

impl SharingCurve {
    /// Returns the curve of a configuration, without numbers that cannot be drawn.
    pub fn new(curve: &Curve<'_>) -> Self {
        let drawable = |value: Option<f64>| value.filter(|value| is_drawable(*value));
        let point = |line: &&UsersLine| {
            Some(SharingPoint {
                edges: line.edges,
                median: drawable(line.totals.median)?,
                p95: drawable(line.totals.p95),
                each: line.edge_performances.iter().filter_map(|edge| drawable(edge.median)).collect(),
                fairness: line.fairness,
            })
        };
        Self { name: curve.name.clone(), points: curve.points.iter().filter_map(point).collect() }
    }
}

impl Sharing {
    fn points(&self) -> impl Iterator<Item = &SharingPoint> {
        self.curves.iter().flat_map(|curve| &curve.points).filter(|point| point.median.is_finite())
    }

    /// Returns the numbers of edges that were measured, each once, in ascending order.
    fn edge_counts(&self) -> Vec<usize> {
        let mut edges: Vec<usize> = self.points().map(|point| point.edges).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    fn has_fairness(&self) -> bool {
        self.points().any(|point| point.fairness.is_some())
    }

    fn legend(&self) -> Vec<Key> {
        let named_curves = self.curves.iter().enumerate().filter(|(_, curve)| !curve.name.is_empty());
        let key = |(number, curve): (usize, &SharingCurve)| {
            let look = series(number);
            Key::new(Swatch::Curve(look.line(LINE_WIDTH), look.mark, look.marks()), curve.name.clone())
        };
        named_curves.map(key).collect()
    }

    fn notes(&self) -> Vec<String> {
        let mut parts = vec!["mark: median"];
        if self.points().any(|point| point.p95.is_some()) {
            parts.push("whisker: to the 95th percentile");
        }
        if self.points().any(|point| point.each.len() > 1) {
            parts.push("dash: one edge’s median");
        }
        std::iter::once(parts.join(" · ")).chain(self.notes.iter().cloned()).collect()
    }

    /// Returns the axis of numbers of edges, with marks at the measured numbers.
    fn edges_axis(&self) -> Option<Axis> {
        let edges = self.edge_counts();
        let (few, many) = (*edges.first()? as f64, *edges.last()? as f64);
        let scale = if many >= few * LOGARITHMIC_EDGES_RATIO {
            let room = (many / few).powf(AXIS_MARGIN);
            Scale::logarithmic((few / room, many * room))
        } else {
            let room = ((many - few) * AXIS_MARGIN).max(0.5);
            Scale::linear((few - room, many + room))
        };
        let tick = |edges: usize| {
            let value = edges as f64;
            Tick { value, at: scale.at(value), text: fixed(value, 0) }
        };
        Some(Axis::new(scale, "Edges at once", "").marked(Marks::At(edges.into_iter().map(tick).collect())))
    }

    /// Returns the lowest and the highest latency, in the unit shown.
    fn latencies(&self) -> Option<(f64, f64)> {
        let ends = |point: &SharingPoint| {
            let all = point.each.iter().copied().chain([point.median]).chain(point.p95);
            let shown = all.filter(|value| value.is_finite()).map(|value| value * self.unit.per_si);
            shown.fold((f64::INFINITY, 0.0_f64), |(lo, hi), value| (lo.min(value), hi.max(value)))
        };
        self.points().map(ends).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let plots =
            self.latencies().zip(self.edges_axis()).map(|(latencies, across)| self.plots(latencies, across));
        Figure {
            title: self.title.clone(),
            legend: self.legend(),
            notes: self.notes(),
            plots: plots.unwrap_or_default(),
            ..Figure::default()
        }
    }

    fn plots(&self, (low, high): (f64, f64), across: Axis) -> Vec<Plot> {
        let y_scale = if low > 0.0 && high > low * LOGARITHMIC_RATIO {
            let room = (high / low).powf(AXIS_MARGIN);
            Scale::logarithmic((low / room, high * room))
        } else {
            Scale::from_zero((0.0, high))
        };
        let mut latency = Plot::new(across.clone(), self.unit.axis(y_scale).with_grid());
        for (number, curve) in self.curves.iter().enumerate() {
            let items = self.curve(&latency, number, curve);
            latency.items.extend(items);
        }
        if !self.has_fairness() {
            return vec![latency];
        }
        let shares = Scale::linear((0.0, 1.0));
        let index = Axis::new(shares, "Fairness of answers/s (Jain’s index)", "").with_grid();
        let mut fairness = Plot::new(across, index);
        fairness.height = Height::Points(FAIRNESS_HEIGHT);
        for (number, curve) in self.curves.iter().enumerate() {
            let points = curve.points.iter().filter(|point| point.median.is_finite());
            let values = points.filter_map(|point| Some((point.edges as f64, point.fairness?)));
            let items = self.line(&fairness, number, values.collect());
            fairness.items.extend(items);
        }
        // Both plots share the horizontal axis, so only the lower plot has its title and its labels.
        latency.x.title.clear();
        if let Marks::At(ticks) = &mut latency.x.marks {
            ticks.iter_mut().for_each(|tick| tick.text.clear());
        }
        vec![latency, fairness]
    }

    fn curve(&self, plot: &Plot, number: usize, curve: &SharingCurve) -> Vec<Item> {
        let look = series(number);
        let (dash, whisker) = (
            Style::line("faint", look.colour.tint(0.5), LINE_WIDTH),
            Style::line("whisk2", look.colour, WHISKER_WIDTH),
        );
        let points = || curve.points.iter().filter(|point| point.median.is_finite());
        let mut items = Vec::new();
        for point in points() {
            let at = |value: f64| {
                plot.at(point.edges as f64, value * self.unit.per_si)
                    .offset_by(self.curve_offset(number), 0.0)
            };
            for value in point.each.iter().filter(|value| value.is_finite() && point.each.len() > 1) {
                items.push(Item::line(
                    at(*value).offset_by(-DASH_HALF_WIDTH, 0.0),
                    at(*value).offset_by(DASH_HALF_WIDTH, 0.0),
                    dash.clone(),
                ));
            }
            if let Some(p95) = point.p95.filter(|p95| p95.is_finite()) {
                items.extend(Item::whisker(
                    [at(point.median), at(p95)],
                    [false, true],
                    CAP_HALF_WIDTH,
                    &whisker,
                ));
            }
        }
        let medians = points().map(|point| (point.edges as f64, point.median * self.unit.per_si));
        items.extend(self.line(plot, number, medians.collect()));
        items
    }

    /// Returns a curve through some values, with its marks.
    fn line(&self, plot: &Plot, number: usize, values: Vec<(f64, f64)>) -> Vec<Item> {
        let (look, dx) = (series(number), self.curve_offset(number));
        let places: Vec<_> = values.into_iter().map(|(x, y)| plot.at(x, y)).collect();
        let line = Path::line(places.iter().map(|at| Some((at.x, at.y)))).offset_by(dx);
        let line = (places.len() > 1).then(|| Item::path(line, look.line(LINE_WIDTH)));
        let marks =
            places.iter().map(|at| Item::mark(at.offset_by(dx, 0.0), look.mark, RADIUS, look.marks()));
        line.into_iter().chain(marks).collect()
    }

    /// Returns the distance in points by which a curve is moved to the right, so that curves do not hide each other.
    fn curve_offset(&self, number: usize) -> f64 {
        HALF_DISTANCE * (2.0 * number as f64 - (self.curves.len() as f64 - 1.0))
    }
}
