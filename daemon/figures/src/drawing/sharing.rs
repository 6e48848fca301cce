//! Figure of latency against the number of edges that share a cloud, with the fairness among these edges.

use peernet_analysis::users::{Curve, UsersLine};
use peernet_statistics::number::fixed;

use super::is_drawable;
use crate::look::{Style, series};
use crate::plot::{Axis, Figure, Height, Item, Key, Marks, Path, Plot, Swatch, Unit};
use crate::scale::{Scale, Tick, is_wide};

/// Maximum number of curves that a reader can distinguish.
pub const MAX_CURVES: usize = 4;
/// Half the distance between the points of two curves at the same number of edges, points.
const HALF_DISTANCE: f64 = 2.0;
/// Half the width of a whisker's cap, points.
const CAP_HALF_WIDTH: f64 = 1.7;
/// Half the width of the dash at the median of one edge, points.
const DASH_HALF_WIDTH: f64 = 2.7;
/// Radius of a point, points.
const RADIUS: f64 = 1.9;
/// Width of the line of a curve and of a dash, points.
const LINE_WIDTH: f64 = 0.75;
/// Width of the line of a whisker, points.
const WHISKER_WIDTH: f64 = 0.45;
/// Height of the plot of fairness, points.
const FAIRNESS_HEIGHT: f64 = 28.5;
/// The axis of edges is logarithmic if the ratio of the largest to the smallest number of edges is at least this.
const LOGARITHMIC_EDGES_RATIO: f64 = 8.0;
/// Room beyond the values at each end of a linear axis, as a share of their range. On a logarithmic axis, the room is a
/// factor: the ratio of the largest to the smallest value to this power.
const AXIS_MARGIN: f64 = 0.06;

/// Latency and fairness against the number of edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Sharing {
    /// Title of the figure.
    pub title: String,
    /// Quantity and unit of the vertical axis: a latency.
    pub unit: Unit,
    /// Curves, at most [`MAX_CURVES`].
    pub curves: Vec<SharingCurve>,
    /// Notes below the figure, such as what is left out.
    pub notes: Vec<String>,
}

/// Curve of one configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct SharingCurve {
    /// Name in the legend; empty if the legend has no entry for the curve.
    pub name: String,
    /// Points of the curve, in ascending order of the number of edges.
    pub points: Vec<SharingPoint>,
}

/// Latency and fairness at one number of edges. Latencies are in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct SharingPoint {
    /// Number of edges.
    pub edges: usize,
    /// Median of the totals of all edges.
    pub median: f64,
    /// 95th percentile of the totals of all edges; `None` if there are too few values.
    pub p95: Option<f64>,
    /// Median of the totals of each edge.
    pub edge_medians: Vec<f64>,
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
                edge_medians: line
                    .edge_performances
                    .iter()
                    .filter_map(|edge| drawable(edge.median))
                    .collect(),
                fairness: line.fairness,
            })
        };
        Self { name: curve.name.clone(), points: curve.points.iter().filter_map(point).collect() }
    }
}

impl Sharing {
    /// Returns the points of all curves that can be drawn.
    fn points(&self) -> impl Iterator<Item = &SharingPoint> {
        self.curves.iter().flat_map(|curve| &curve.points).filter(|point| point.median.is_finite())
    }

    /// Returns the numbers of edges that were measured, without duplicates, in ascending order.
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
        let key = |(index, curve): (usize, &SharingCurve)| {
            let look = series(index);
            Key::new(Swatch::Curve(look.line(LINE_WIDTH), look.mark, look.marks()), curve.name.clone())
        };
        named_curves.map(key).collect()
    }

    fn notes(&self) -> Vec<String> {
        let mut explanations = vec!["mark: median"];
        if self.points().any(|point| point.p95.is_some()) {
            explanations.push("whisker: to the 95th percentile");
        }
        if self.points().any(|point| point.edge_medians.len() > 1) {
            explanations.push("dash: one edge’s median");
        }
        std::iter::once(explanations.join(" · ")).chain(self.notes.iter().cloned()).collect()
    }

    /// Returns the axis of numbers of edges, with marks at the measured numbers.
    fn edges_axis(&self) -> Option<Axis> {
        let edges = self.edge_counts();
        let (fewest, most) = (*edges.first()? as f64, *edges.last()? as f64);
        let scale = if most >= fewest * LOGARITHMIC_EDGES_RATIO {
            let room = (most / fewest).powf(AXIS_MARGIN);
            Scale::logarithmic((fewest / room, most * room))
        } else {
            let room = ((most - fewest) * AXIS_MARGIN).max(0.5);
            Scale::linear((fewest - room, most + room))
        };
        // Marks at round numbers could be numbers of edges that were not measured.
        let tick = |edges: usize| {
            let value = edges as f64;
            Tick { value, at: scale.at(value), text: fixed(value, 0) }
        };
        Some(Axis::new(scale, "Edges at once", "").marked(Marks::At(edges.into_iter().map(tick).collect())))
    }

    /// Returns the lowest and the highest latency, in the unit that is shown.
    fn latency_range(&self) -> Option<(f64, f64)> {
        let ends = |point: &SharingPoint| {
            let all = point.edge_medians.iter().copied().chain([point.median]).chain(point.p95);
            let shown = all.filter(|value| value.is_finite()).map(|value| value * self.unit.per_si);
            shown.fold((f64::INFINITY, 0.0_f64), |(lo, hi), value| (lo.min(value), hi.max(value)))
        };
        self.points().map(ends).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let plots = self
            .latency_range()
            .zip(self.edges_axis())
            .map(|(latencies, edges)| self.plots(latencies, edges));
        Figure {
            title: self.title.clone(),
            legend: self.legend(),
            notes: self.notes(),
            plots: plots.unwrap_or_default(),
            ..Figure::default()
        }
    }

    /// Returns the plot of latencies between `low` and `high` and, below it, the plot of fairness if fairness is known.
    fn plots(&self, (low, high): (f64, f64), edges_axis: Axis) -> Vec<Plot> {
        let y_scale = if is_wide((low, high)) {
            let room = (high / low).powf(AXIS_MARGIN);
            Scale::logarithmic((low / room, high * room))
        } else {
            Scale::from_zero((0.0, high))
        };
        let mut latency = Plot::new(edges_axis.clone(), self.unit.axis(y_scale).with_grid());
        for (index, curve) in self.curves.iter().enumerate() {
            let items = self.curve_items(&latency, index, curve);
            latency.items.extend(items);
        }
        if !self.has_fairness() {
            return vec![latency];
        }
        let index_scale = Scale::linear((0.0, 1.0));
        let fairness_axis = Axis::new(index_scale, "Fairness of answers/s (Jain’s index)", "").with_grid();
        let mut fairness = Plot::new(edges_axis, fairness_axis);
        fairness.height = Height::Points(FAIRNESS_HEIGHT);
        for (index, curve) in self.curves.iter().enumerate() {
            let points = curve.points.iter().filter(|point| point.median.is_finite());
            let values = points.filter_map(|point| Some((point.edges as f64, point.fairness?)));
            let items = self.line_and_marks(&fairness, index, values.collect());
            fairness.items.extend(items);
        }
        // Both plots share the horizontal axis, so its title and labels are removed from the upper plot.
        latency.x.title.clear();
        if let Marks::At(ticks) = &mut latency.x.marks {
            ticks.iter_mut().for_each(|tick| tick.text.clear());
        }
        vec![latency, fairness]
    }

    /// Returns the items of the latencies of the curve with this index: dashes, whiskers, line and marks.
    fn curve_items(&self, plot: &Plot, index: usize, curve: &SharingCurve) -> Vec<Item> {
        let look = series(index);
        let (dash, whisker) = (
            Style::line("faint", look.colour.tint(0.5), LINE_WIDTH),
            Style::line("whisk2", look.colour, WHISKER_WIDTH),
        );
        let points = || curve.points.iter().filter(|point| point.median.is_finite());
        let mut items = Vec::new();
        for point in points() {
            let at = |value: f64| {
                plot.at(point.edges as f64, value * self.unit.per_si).offset_by(self.curve_offset(index), 0.0)
            };
            // The median of a single edge is the median of all edges, so the edge needs no dash.
            for value in
                point.edge_medians.iter().filter(|value| value.is_finite() && point.edge_medians.len() > 1)
            {
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
        items.extend(self.line_and_marks(plot, index, medians.collect()));
        items
    }

    /// Returns the line of the curve with this index through these values, with a mark at each value.
    fn line_and_marks(&self, plot: &Plot, index: usize, values: Vec<(f64, f64)>) -> Vec<Item> {
        let (look, dx) = (series(index), self.curve_offset(index));
        let places: Vec<_> = values.into_iter().map(|(x, y)| plot.at(x, y)).collect();
        let line = Path::line(places.iter().map(|at| Some((at.x, at.y)))).offset_by(dx);
        let line = (places.len() > 1).then(|| Item::path(line, look.line(LINE_WIDTH)));
        let marks =
            places.iter().map(|at| Item::mark(at.offset_by(dx, 0.0), look.mark, RADIUS, look.marks()));
        line.into_iter().chain(marks).collect()
    }

    /// Returns the distance by which the curve with this index is moved to the right, so that curves do not hide each
    /// other; points.
    fn curve_offset(&self, index: usize) -> f64 {
        HALF_DISTANCE * (2.0 * index as f64 - (self.curves.len() as f64 - 1.0))
    }
}
