//! How something grows with size: logarithmic axes, a point per size with what is known of it, a line per series.

use peernet_statistics::number::bytes;
use plotters::element::{PathElement, Rectangle};
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor, ShapeStyle};

use super::kit::{Axis, Drawn, Figure, Frame, Header, Key, Mark, Paper, SIZE, Swatch, Unit};

/// Half the distance between two series at one size.
const APART: i32 = 13;
/// Half the width of a bar.
const BAR: i32 = 9;
/// Half the width of a whisker's cap.
const CAP: i32 = 11;
/// Room beyond the values at each end: this power of the range, but at least so much.
const ROOM: (f64, f64) = (0.06, 1.15);
/// A level line so many times above or below all values would squeeze them: it is left out, and a note says so.
const FAR: f64 = 20.0;

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

impl Value {
    /// The whisker; none where both ends read one clock.
    fn whisker(&self) -> Option<(f64, Option<f64>)> {
        self.bounds.filter(|(lo, hi)| hi.is_none_or(|hi| hi > *lo))
    }
}

/// What the parts of a figure are, in a few words each; what is not drawn is not explained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts {
    /// The points.
    pub point: &'static str,
    /// The whiskers.
    pub whisker: &'static str,
    /// The lines.
    pub line: &'static str,
}

/// A figure of series over size.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaling {
    /// What is shown; nothing where it is empty.
    pub title: String,
    /// What stands along the vertical axis.
    pub unit: Unit,
    /// What its parts are; bars are always from the 5th to the 95th percentile.
    pub parts: Parts,
    /// What else is to be said of the values.
    pub notes: Vec<String>,
    /// At most two.
    pub series: Vec<Series>,
}

impl Scaling {
    fn values(&self) -> impl Iterator<Item = &Value> {
        self.series.iter().flat_map(|series| &series.values).filter(|value| value.value > 0.0)
    }

    /// From the lowest to the highest of all that is known of the values.
    fn heights(&self) -> Option<(f64, f64)> {
        let of = |value: &Value| {
            let (lo, hi) = value.spread.unwrap_or((value.value, value.value));
            let whisker = value.whisker();
            let most = whisker.and_then(|bounds| bounds.1).map_or(hi, |bound| bound.min(value.value * 10.0));
            // A lower bound near nothing would squeeze all the rest.
            let least = whisker.map_or(lo, |bounds| bounds.0.max(value.value / 4.0));
            (least.min(lo).max(value.value / 100.0), most.max(hi))
        };
        self.values().map(of).reduce(|(lo, hi), (a, b)| (lo.min(a), hi.max(b)))
    }

    /// The height of a series' level line, and whether it is near enough to be drawn.
    fn level(&self, series: &Series) -> Option<(f64, bool)> {
        let (height, _) = series.line.filter(|(height, slope)| *slope == 0.0 && *height > 0.0)?;
        let (low, high) = self.heights()?;
        Some((height, height <= high * FAR && height >= low / FAR))
    }

    /// What is seen in the picture, and what is not.
    fn explained(&self) -> Vec<String> {
        let far = |series: &Series| self.level(series).is_some_and(|(_, is_near)| !is_near);
        let mut parts = vec![format!("point: {}", self.parts.point)];
        if self.values().any(|value| value.spread.is_some()) {
            parts.push("bar: 5th to 95th percentile".to_owned());
        }
        if self.values().any(|value| value.whisker().is_some()) {
            parts.push(format!("whisker: {}", self.parts.whisker));
        }
        if self.series.iter().any(|series| series.line.is_some() && !far(series)) {
            parts.push(format!("line: {}", self.parts.line));
        }
        let mut notes = vec![parts.join(" · ")];
        let beyond: Vec<&str> = self
            .series
            .iter()
            .filter(|series| far(series))
            .map(|series| series.name.split(':').next().unwrap_or_default())
            .collect();
        if !beyond.is_empty() {
            notes.push(format!("far beyond the axis and not drawn: the line of {}", beyond.join(" and of ")));
        }
        notes.extend(self.notes.iter().cloned());
        notes
    }

    /// Axes that hold all values and level lines; `None` when there is no value above zero.
    fn frame(&self, header: i32) -> Option<Frame> {
        let sizes = self.values().map(|value| (value.bytes, value.bytes));
        let (small, large) = sizes.reduce(|(lo, hi), (a, b)| (lo.min(a), hi.max(b)))?;
        let levels = self.series.iter().filter_map(|series| self.level(series)).filter(|(_, near)| *near);
        let (low, high) = levels.fold(self.heights()?, |(lo, hi), (level, _)| (lo.min(level), hi.max(level)));
        let room = (high / low).powf(ROOM.0).max(ROOM.1);
        let shown = (low * self.unit.per_si / room, high * self.unit.per_si * room);
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
        let is_far = self.level(series).is_some_and(|(_, is_near)| !is_near);
        if let Some((intercept, slope)) = series.line.filter(|_| !is_far) {
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
            series.mark.draw_line(paper, line, colour)?;
        }
        for value in series.values.iter().filter(|value| value.value > 0.0) {
            let at = x.at(value.bytes) + aside;
            let height = |value: f64| y.at(show(value));
            if let Some((lo, hi)) = value.spread {
                let bar = [(at - BAR, height(hi)), (at + BAR, height(lo))];
                paper.draw(&Rectangle::new(bar, colour.mix(0.35).filled()))?;
            }
            if let Some((lo, hi)) = value.whisker() {
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
        let key = |series: &Series| Key::new(Swatch::Curve(series.colour, series.mark), series.name.clone());
        let header = Header {
            title: self.title.clone(),
            keys: self.series.iter().map(key).collect(),
            notes: self.explained(),
        };
        let Some(frame) = self.frame(header.draw(paper)?) else { return Ok(()) };
        frame.draw_y(paper, (&self.unit.title, 0))?;
        frame.draw_x(paper, "Size on the wire", |tick| bytes(tick.value).plain())?;
        let middle = self.series.len() as i32 - 1;
        for (index, series) in self.series.iter().enumerate() {
            self.draw_series(paper, &frame, (series, APART * (2 * index as i32 - middle)))?;
        }
        Ok(())
    }
}
