//! How something grows with size: logarithmic axes, a point per size with what is known of it, a line per series.

use plotters::coord::Shift;
use plotters::element::{Circle, DashedPathElement, PathElement, Rectangle, Text, TriangleMarker};
use plotters::prelude::{DrawingArea, DrawingBackend};
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, RGBColor, ShapeStyle};

use super::axis::Axis;
use super::canvas::{Drawn, Figure, SIZE, SMALL, TEXT, style};
use super::colour::{AXIS, GRID, INK, QUIET};
use crate::number::{bytes, significant};

/// Room around the plot, pixels: left, right, bottom.
const LEFT: i32 = 180;
const RIGHT: i32 = 50;
const BOTTOM: i32 = 160;
/// Distance between lines of text above the plot.
const LINE: i32 = 66;
/// Half the distance between two series at one size.
const APART: i32 = 13;
/// Half the width of a bar.
const BAR: i32 = 9;
/// Half the width of a whisker's cap.
const CAP: i32 = 11;

/// What is measured: how it is called and how a value in SI units becomes the number shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// With the unit: `One-way delay, ms`.
    pub title: &'static str,
    /// The number shown per SI unit.
    pub per_si: f64,
}

/// How the points and the line of a series look, so that they differ without colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Discs on a solid line.
    Disc,
    /// Triangles on a dashed line.
    Triangle,
}

/// What is known at one size, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Value {
    /// Bytes.
    pub bytes: f64,
    /// The point.
    pub value: f64,
    /// The bar: where most values lie.
    pub spread: Option<(f64, f64)>,
    /// The whisker: where the truth lies. Without an upper end it leaves the plot.
    pub bounds: Option<(f64, Option<f64>)>,
}

/// One series.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// What it is, for the key.
    pub name: String,
    /// Its colour.
    pub colour: RGBColor,
    /// Its mark.
    pub mark: Mark,
    /// A point per size.
    pub values: Vec<Value>,
    /// Its line: intercept and slope, in SI units and per byte.
    pub line: Option<(f64, f64)>,
}

/// A figure of series over size.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaling {
    /// What stands along the vertical axis.
    pub unit: Unit,
    /// What the parts of a point are, in a few words.
    pub note: &'static str,
    /// At most two.
    pub series: Vec<Series>,
}

impl Scaling {
    /// Axes that hold all values; `None` when there is none above zero.
    fn axes(&self, top: i32) -> Option<(Axis, Axis)> {
        let values =
            || self.series.iter().flat_map(|series| &series.values).filter(|value| value.value > 0.0);
        let range = |of: &dyn Fn(&Value) -> (f64, f64)| {
            let join = |(lo, hi): (f64, f64), (a, b): (f64, f64)| (lo.min(a), hi.max(b));
            values().map(of).reduce(join)
        };
        let (small, large) = range(&|value| (value.bytes, value.bytes))?;
        let (low, high) = range(&|value| {
            let (lo, hi) = value.spread.unwrap_or((value.value, value.value));
            let most =
                value.bounds.and_then(|bounds| bounds.1).map_or(hi, |bound| bound.min(value.value * 10.0));
            // A lower bound near nothing would squeeze all the rest.
            let least = value.bounds.map_or(lo, |bounds| bounds.0.max(value.value / 4.0));
            (least.min(lo).max(value.value / 100.0), most.max(hi))
        })?;
        let (width, height) = (SIZE.0 as i32, SIZE.1 as i32);
        let x = Axis { values: (small / 1.4, large * 1.4), pixels: (LEFT, width - RIGHT) };
        let y = Axis {
            values: (low * self.unit.per_si / 1.3, high * self.unit.per_si * 1.3),
            pixels: (height - BOTTOM, top),
        };
        Some((x, y))
    }

    fn draw_key<DB: DrawingBackend>(&self, paper: &DrawingArea<DB, Shift>) -> Drawn<DB> {
        let text = style(TEXT, INK, HPos::Left, VPos::Center);
        for (row, series) in self.series.iter().enumerate() {
            let y = 50 + LINE * row as i32;
            paper.draw(&PathElement::new([(40, y), (130, y)], series.colour.stroke_width(5)))?;
            draw_mark(paper, series, (85, y))?;
            paper.draw(&Text::new(series.name.clone(), (160, y + 3), text.clone()))?;
        }
        let y = 50 + LINE * self.series.len() as i32;
        paper.draw(&Text::new(self.note, (40, y), style(SMALL, QUIET, HPos::Left, VPos::Center)))
    }

    fn draw_axes<DB: DrawingBackend>(&self, paper: &DrawingArea<DB, Shift>, x: &Axis, y: &Axis) -> Drawn<DB> {
        let ((left, right), (bottom, top)) = (x.pixels, y.pixels);
        for tick in y.ticks() {
            let at = y.at(tick);
            paper.draw(&PathElement::new([(left, at), (right, at)], GRID.stroke_width(3)))?;
            let text = style(TEXT, QUIET, HPos::Right, VPos::Center);
            paper.draw(&Text::new(tick_label(tick), (left - 18, at + 3), text))?;
        }
        paper.draw(&PathElement::new([(left, bottom), (right, bottom)], AXIS.stroke_width(3)))?;
        for tick in x.ticks() {
            let at = x.at(tick);
            paper.draw(&PathElement::new([(at, bottom), (at, bottom + 12)], AXIS.stroke_width(3)))?;
            let text = style(TEXT, QUIET, HPos::Center, VPos::Top);
            paper.draw(&Text::new(bytes(tick), (at, bottom + 22), text))?;
        }
        let title = style(TEXT, QUIET, HPos::Left, VPos::Bottom);
        paper.draw(&Text::new(self.unit.title, (40, top - 18), title))?;
        let title = style(TEXT, QUIET, HPos::Center, VPos::Bottom);
        paper.draw(&Text::new(
            "Size on the wire, bytes",
            (i32::midpoint(left, right), SIZE.1 as i32 - 16),
            title,
        ))
    }

    fn draw_series<DB: DrawingBackend>(
        &self,
        paper: &DrawingArea<DB, Shift>,
        (x, y): (&Axis, &Axis),
        (series, aside): (&Series, i32),
    ) -> Drawn<DB> {
        let show = |value: f64| value * self.unit.per_si;
        let colour = series.colour;
        if let Some((intercept, slope)) = series.line {
            let (left, right) = x.pixels;
            let line: Vec<(i32, i32)> = if slope == 0.0 {
                vec![(left, y.at(show(intercept))), (right, y.at(show(intercept)))]
            } else {
                let values = x.along(60).map(|bytes| (bytes, show(intercept + slope * bytes)));
                let inside = values.filter(|(_, value)| (y.values.0..=y.values.1).contains(value));
                // Aside like its points, so that they lie on it where they should.
                let points = inside.map(|(bytes, value)| (x.at(bytes) + aside, y.at(value)));
                points.filter(|(at, _)| (left..=right).contains(at)).collect()
            };
            match series.mark {
                Mark::Disc => paper.draw(&PathElement::new(line, colour.stroke_width(5)))?,
                // Two lines that lie on each other are both seen.
                Mark::Triangle => {
                    paper.draw(&DashedPathElement::new(line, 22, 16, colour.stroke_width(5)))?;
                }
            }
        }
        for value in series.values.iter().filter(|value| value.value > 0.0) {
            let at = x.at(value.bytes) + aside;
            let height = |value: f64| y.at(show(value));
            if let Some((lo, hi)) = value.spread {
                let bar = [(at - BAR, height(hi)), (at + BAR, height(lo))];
                paper.draw(&Rectangle::new(bar, colour.mix(0.35).filled()))?;
            }
            if let Some((lo, hi)) = value.bounds {
                let (below, above) = (height(lo), hi.map_or(y.pixels.1, height));
                let whisker: ShapeStyle = colour.stroke_width(3);
                paper.draw(&PathElement::new([(at, below), (at, above)], whisker))?;
                // A whisker that leaves the plot has no cap.
                let ends =
                    [(show(lo) >= y.values.0, below), (hi.is_some_and(|hi| show(hi) <= y.values.1), above)];
                for (_, end) in ends.into_iter().filter(|(inside, _)| *inside) {
                    paper.draw(&PathElement::new([(at - CAP, end), (at + CAP, end)], whisker))?;
                }
            }
            draw_mark(paper, series, (at, height(value.value)))?;
        }
        Ok(())
    }
}

impl Figure for Scaling {
    fn draw<DB: DrawingBackend>(&self, paper: &DrawingArea<DB, Shift>) -> Drawn<DB> {
        self.draw_key(paper)?;
        let top = 50 + LINE * (self.series.len() as i32 + 2) + 10;
        let Some((x, y)) = self.axes(top) else { return Ok(()) };
        self.draw_axes(paper, &x, &y)?;
        let middle = self.series.len() as i32 - 1;
        for (index, series) in self.series.iter().enumerate() {
            self.draw_series(paper, (&x, &y), (series, APART * (2 * index as i32 - middle)))?;
        }
        Ok(())
    }
}

fn draw_mark<DB: DrawingBackend>(
    paper: &DrawingArea<DB, Shift>,
    series: &Series,
    at: (i32, i32),
) -> Drawn<DB> {
    let style = series.colour.filled();
    match series.mark {
        Mark::Disc => paper.draw(&Circle::new(at, 12, style)),
        Mark::Triangle => paper.draw(&TriangleMarker::new(at, 16, style)),
    }
}

/// A power of ten, or 2 or 5 of them, without needless zeros.
fn tick_label(value: f64) -> String {
    let text = significant(value);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
