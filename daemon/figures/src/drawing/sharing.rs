//! How latency grows with the number of edges that share one cloud, and how evenly they are served.

use peernet_statistics::number::fixed;
use plotters::element::PathElement;
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor};

use super::histogram::nothing;
use super::kit::{Axis, Drawn, Figure, Frame, Header, Key, Mark, Paper, SERIES, SIZE, Swatch, Tick, Unit};

/// Most curves that can be told apart.
pub const MOST_CURVES: usize = SERIES.len();
/// Half the distance between two curves at one number of edges, pixels.
const APART: i32 = 13;
/// Half the width of a whisker's cap, and of the dash of a single edge.
const CAP: i32 = 11;
const DASH: i32 = 18;
/// Height of the panel of fairness, and what lies between it and the plot above.
const PANEL: i32 = 190;
const BETWEEN: i32 = 116;
/// From this ratio of the most to the fewest edges on, their axis is logarithmic; from that of latencies theirs.
const WIDE_EDGES: f64 = 8.0;
const WIDE: f64 = 12.0;
/// Room beyond the values at each end, as a share of their range.
const ROOM: f64 = 0.06;

/// Latency and fairness against the number of edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Sharing {
    /// What is shown.
    pub title: String,
    /// The vertical axis: a latency.
    pub unit: Unit,
    /// At most four.
    pub curves: Vec<SharingCurve>,
    /// What is left out and so on.
    pub notes: Vec<String>,
}

/// One configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct SharingCurve {
    /// For the key; nothing where it is empty.
    pub name: String,
    /// The fewest edges first.
    pub points: Vec<SharingPoint>,
}

/// What some edges at once were given. Seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct SharingPoint {
    /// How many.
    pub edges: usize,
    /// Median of all of them.
    pub median: f64,
    /// The 95th percentile of all of them; `None` of few values.
    pub p95: Option<f64>,
    /// The median of each.
    pub each: Vec<f64>,
    /// Jain's index of their rates, from 0 to 1.
    pub fairness: Option<f64>,
}

impl Sharing {
    fn points(&self) -> impl Iterator<Item = &SharingPoint> {
        self.curves.iter().flat_map(|curve| &curve.points).filter(|point| point.median.is_finite())
    }

    /// The numbers of edges, each once.
    fn edges(&self) -> Vec<usize> {
        let mut edges: Vec<usize> = self.points().map(|point| point.edges).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    fn has_fairness(&self) -> bool {
        self.points().any(|point| point.fairness.is_some())
    }

    fn header(&self) -> Header {
        let named = self.curves.iter().enumerate().filter(|(_, curve)| !curve.name.is_empty());
        let key = |(number, curve): (usize, &SharingCurve)| {
            let (colour, mark) = look(number);
            Key::new(Swatch::Curve(colour, mark), curve.name.clone())
        };
        let mut parts = vec!["mark: median"];
        if self.points().any(|point| point.p95.is_some()) {
            parts.push("whisker: to the 95th percentile");
        }
        if self.points().any(|point| point.each.len() > 1) {
            parts.push("dash: one edge’s median");
        }
        let notes = std::iter::once(parts.join(" · ")).chain(self.notes.iter().cloned());
        Header { title: self.title.clone(), keys: named.map(key).collect(), notes: notes.collect() }
    }

    /// Whole edges, marked where they were measured.
    fn across(&self, pixels: (i32, i32)) -> Option<Axis> {
        let edges = self.edges();
        let (few, many) = (*edges.first()? as f64, *edges.last()? as f64);
        Some(if many >= few * WIDE_EDGES {
            let room = (many / few).powf(ROOM);
            Axis::logarithmic((few / room, many * room), pixels)
        } else {
            let room = ((many - few) * ROOM).max(0.5);
            Axis::linear((few - room, many + room), pixels)
        })
    }

    /// From the lowest to the highest that is known, as shown.
    fn latencies(&self) -> Option<(f64, f64)> {
        let ends = |point: &SharingPoint| {
            let all = point.each.iter().copied().chain([point.median]).chain(point.p95);
            let shown = all.filter(|value| value.is_finite()).map(|value| value * self.unit.per_si);
            shown.fold((f64::INFINITY, 0.0_f64), |(lo, hi), value| (lo.min(value), hi.max(value)))
        };
        self.points().map(ends).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    fn draw_curve<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        frame: &Frame,
        (number, curve): (usize, &SharingCurve),
    ) -> Drawn<DB> {
        let (colour, mark) = look(number);
        let across = |point: &SharingPoint| frame.x.at(point.edges as f64) + self.aside(number);
        let up = |value: f64| frame.y.at(value * self.unit.per_si);
        let shown = || curve.points.iter().filter(|point| point.median.is_finite());
        for point in shown() {
            let at = across(point);
            for value in point.each.iter().filter(|value| value.is_finite() && point.each.len() > 1) {
                let dash = [(at - DASH, up(*value)), (at + DASH, up(*value))];
                paper.draw(&PathElement::new(dash, colour.mix(0.45).stroke_width(5)))?;
            }
            if let Some(late) = point.p95.filter(|late| late.is_finite()) {
                let pen = colour.stroke_width(3);
                paper.draw(&PathElement::new([(at, up(point.median)), (at, up(late))], pen))?;
                paper.draw(&PathElement::new([(at - CAP, up(late)), (at + CAP, up(late))], pen))?;
            }
        }
        mark.draw_curve(paper, shown().map(|point| (across(point), up(point.median))).collect(), colour)
    }

    fn draw_fairness<DB: DrawingBackend>(&self, paper: &Paper<DB>, frame: &Frame) -> Drawn<DB> {
        for (number, curve) in self.curves.iter().enumerate() {
            let (colour, mark) = look(number);
            let points = curve.points.iter().filter(|point| point.median.is_finite());
            let points = points.filter_map(|point| {
                Some((frame.x.at(point.edges as f64) + self.aside(number), frame.y.at(point.fairness?)))
            });
            mark.draw_curve(paper, points.collect(), colour)?;
        }
        Ok(())
    }

    fn aside(&self, number: usize) -> i32 {
        APART * (2 * number as i32 - (self.curves.len() as i32 - 1))
    }
}

fn up((low, high): (f64, f64), pixels: (i32, i32)) -> Axis {
    if low > 0.0 && high > low * WIDE {
        let room = (high / low).powf(ROOM);
        Axis::logarithmic((low / room, high * room), pixels)
    } else {
        Axis::from_zero((0.0, high), pixels)
    }
}

fn look(number: usize) -> (RGBColor, Mark) {
    (SERIES[number % MOST_CURVES], Mark::ALL[number % MOST_CURVES])
}

impl Figure for Sharing {
    fn size(&self) -> (u32, u32) {
        let panel = if self.has_fairness() { PANEL + BETWEEN } else { 0 };
        (SIZE.0, SIZE.1 + panel as u32)
    }

    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let top = self.header().draw(paper)?;
        let Some(latencies) = self.latencies() else { return nothing(paper, top) };
        let up = Frame::below(top, SIZE.1 as i32, |pixels| up(latencies, pixels));
        let base = up.pixels.0 + BETWEEN + PANEL;
        let fair = self.has_fairness().then(|| Axis::linear((0.0, 1.0), (base, base - PANEL)));
        let begins = |axis: &Axis| Frame::beside(axis, SIZE.0 as i32).0;
        let left = begins(&up).max(fair.as_ref().map_or(0, begins));
        let Some(x) = self.across((left, Frame::beside(&up, SIZE.0 as i32).1)) else { return Ok(()) };
        let count = |edges: usize| Tick { value: edges as f64, text: fixed(edges as f64, 0) };
        let ticks: Vec<Tick> = self.edges().into_iter().map(count).collect();
        let frame = Frame { x, y: up };
        frame.draw_y(paper, (&self.unit.title, 0))?;
        for (number, curve) in self.curves.iter().enumerate() {
            self.draw_curve(paper, &frame, (number, curve))?;
        }
        let lowest = match fair {
            None => frame,
            Some(fair) => {
                let panel = Frame { x, y: fair };
                frame.draw_base(paper, &ticks)?;
                panel.draw_y(paper, ("Fairness of answers/s (Jain’s index)", 0))?;
                self.draw_fairness(paper, &panel)?;
                panel
            }
        };
        lowest.draw_x_at(paper, "Edges at once", &ticks)
    }
}
