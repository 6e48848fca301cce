//! How something grows with size: logarithmic axes, a point per size with what is known of it, a line per series.

use plotters::element::{DashedPathElement, PathElement, Rectangle};
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor, ShapeStyle};

use super::kit::{Axis, Drawn, Figure, Frame, Header, Key, Mark, Paper, SIZE, Swatch, Unit};
use crate::number::bytes;

/// Half the distance between two series at one size.
const APART: i32 = 13;
/// Half the width of a bar.
const BAR: i32 = 9;
/// Half the width of a whisker's cap.
const CAP: i32 = 11;

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
    fn frame(&self, header: i32) -> Option<Frame> {
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
        let shown = (low * self.unit.per_si / 1.3, high * self.unit.per_si * 1.3);
        let y = Frame::below(header, SIZE.1 as i32, |pixels| Axis::logarithmic(shown, pixels));
        let x = Axis::logarithmic((small / 1.4, large * 1.4), Frame::beside(&y, SIZE.0 as i32));
        Some(Frame { x, y })
    }

    fn draw_series<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        Frame { x, y }: &Frame,
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
                let inside = values.filter(|(_, value)| y.has(*value));
                // Aside like its points, so that they lie on it where they should.
                let points = inside.map(|(bytes, value)| (x.at(bytes) + aside, y.at(value)));
                points.filter(|(at, _)| (left..=right).contains(at)).collect()
            };
            match series.mark {
                Mark::Disc => paper.draw(&PathElement::new(line, colour.stroke_width(5)))?,
                // Two lines that lie on each other are both seen.
                _ => {
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
            series.mark.draw(paper, (at, height(value.value)), colour)?;
        }
        Ok(())
    }
}

impl Figure for Scaling {
    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let key = |series: &Series| Key::new(Swatch::Mark(series.colour, series.mark), series.name.clone());
        let header = Header {
            title: String::new(),
            keys: self.series.iter().map(key).collect(),
            notes: vec![self.note.to_owned()],
        };
        let Some(frame) = self.frame(header.draw(paper)?) else { return Ok(()) };
        frame.draw_y(paper, (&self.unit.title, 0))?;
        frame.draw_x(paper, "Size on the wire, bytes", |tick| bytes(tick.value))?;
        let middle = self.series.len() as i32 - 1;
        for (index, series) in self.series.iter().enumerate() {
            self.draw_series(paper, &frame, (series, APART * (2 * index as i32 - middle)))?;
        }
        Ok(())
    }
}
