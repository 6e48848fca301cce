//! How a run went: latency over time, with episodes, warm-up and whatever had no answer.

mod columns;

use peernet_statistics::number::fixed;
use plotters::element::{Circle, DashedPathElement, PathElement, Polygon, Rectangle};
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor, ShapeStyle};

use super::histogram::{nothing, range};
use super::kit::{
    AXIS, Axis, Drawn, Figure, Fill, Frame, GRID, Hatch, Header, Key, Mark, Paper, SHADE, SIZE, Swatch, Unit,
};
use columns::{Column, columns};
use peernet_analysis::order::Ordered;

/// Width of a column, pixels.
const COLUMN: i32 = 5;
/// Height of the rail that holds what had no answer.
const RAIL: i32 = 46;
/// How many marks a line has at most.
const MARKS: usize = 7;
/// Between the marks of so many lines there is room.
const STAGES: usize = 4;
/// A line is broken where so many columns have no value.
const GAP: f64 = 12.0;
/// From how many episodes on their borders would be all that is seen.
const MOST_BORDERS: usize = 30;
const LOST: RGBColor = RGBColor(0x9b, 0x16, 0x20);

/// Latencies over time. SI units; times are those of the horizontal axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// What is shown.
    pub title: String,
    /// The horizontal axis: `Time since the start, s`, `Iteration`.
    pub x: String,
    /// Whether it holds numbers of iterations instead of times.
    pub is_counted: bool,
    /// The vertical axis.
    pub unit: Unit,
    /// What is shown whole: the range of each column of pixels, and its median.
    pub total: Line,
    /// What is shown beneath as medians.
    pub stages: Vec<Line>,
    /// From when to when was warm-up.
    pub warm_up: Vec<(f64, f64)>,
    /// When episodes began, but for the first.
    pub episodes: Vec<f64>,
    /// When there was no answer.
    pub unanswered: Vec<f64>,
    /// What is left out and so on.
    pub notes: Vec<String>,
}

/// A quantity over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Its name.
    pub name: String,
    /// Its colour.
    pub colour: RGBColor,
    /// Time and value.
    pub values: Vec<(f64, f64)>,
}

impl Course {
    fn times(&self) -> Option<(f64, f64)> {
        let lines = self.stages.iter().chain([&self.total]);
        let times = lines
            .flat_map(|line| line.values.iter().map(|(at, _)| *at))
            .chain(self.unanswered.iter().copied());
        times.filter(|at| at.is_finite()).fold(None, |range: Option<(f64, f64)>, at| {
            Some(range.map_or((at, at), |(lo, hi)| (lo.min(at), hi.max(at))))
        })
    }

    fn shown(&self) -> Option<(f64, f64)> {
        let of = |line: &Line| {
            range(&line.values.iter().map(|(_, value)| *value).filter(|v| v.is_finite()).collect::<Ordered>())
        };
        let total = of(&self.total);
        // A stage is a part of the total: what of it lies beyond the total's range is an outlier as well.
        let most = total.map_or(f64::INFINITY, |(_, most)| most);
        let stages = self.stages.iter().filter_map(of).map(|(lo, hi)| (lo, hi.min(most)));
        stages.chain(total).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    fn has_borders(&self) -> bool {
        !self.episodes.is_empty() && self.episodes.len() <= MOST_BORDERS
    }

    fn header(&self) -> Header {
        let mut keys = vec![Key::new(
            Swatch::Line(self.total.colour, false),
            format!("{} (band: range)", self.total.name),
        )];
        let stages = self.stages.iter().enumerate();
        keys.extend(stages.map(|(number, line)| {
            Key::new(Swatch::Mark(line.colour, Mark::ALL[number % 4]), line.name.clone())
        }));
        if !self.warm_up.is_empty() {
            let shade = Fill::pale(SHADE, AXIS, Hatch::Plain);
            keys.push(Key::new(Swatch::Area(shade), "warm-up"));
        }
        if !self.unanswered.is_empty() {
            let text = format!("no answer ({})", fixed(self.unanswered.len() as f64, 0));
            keys.push(Key::new(Swatch::Mark(LOST, Mark::Cross), text));
        }
        if self.has_borders() {
            keys.push(Key::new(Swatch::Line(AXIS, true), "new episode"));
        }
        Header { title: self.title.clone(), keys, notes: self.notes.clone() }
    }

    fn draw_ground<DB: DrawingBackend>(&self, paper: &Paper<DB>, frame: &Frame) -> Drawn<DB> {
        let (bottom, top) = frame.y.pixels;
        for (from, to) in &self.warm_up {
            let from = frame.x.at(*from);
            let area = [(from, top), (frame.x.at(*to).max(from + 4), bottom)];
            paper.draw(&Rectangle::new(area, SHADE.filled()))?;
        }
        for at in self.episodes.iter().filter(|_| self.has_borders()) {
            let line = [(frame.x.at(*at), bottom), (frame.x.at(*at), top)];
            paper.draw(&DashedPathElement::new(line, 10, 10, AXIS.stroke_width(3)))?;
        }
        Ok(())
    }

    fn draw_line<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        frame: &Frame,
        (line, mark): (&Line, Option<Mark>),
    ) -> Drawn<DB> {
        let (left, right) = frame.x.pixels;
        let count = ((right - left) / COLUMN).max(1) as usize;
        let columns = columns(&line.values, frame.x.values, count);
        let y = |value: f64| frame.y.at(value * self.unit.per_si);
        let x = |column: &Column| left + COLUMN * column.number as i32 + COLUMN / 2;
        let steps: Ordered =
            columns.windows(2).map(|pair| (pair[1].number - pair[0].number) as f64).collect();
        // Few values are far from each other, and no gap is between them.
        let gap = (4.0 * steps.median().unwrap_or_default()).max(GAP);
        let pieces = || columns.chunk_by(|a, b| (b.number - a.number) as f64 <= gap);
        if mark.is_none() {
            for piece in pieces() {
                let upper = piece.iter().map(|column| (x(column), y(column.max) - 1));
                let lower = piece.iter().rev().map(|column| (x(column), y(column.min) + 1));
                let outline: Vec<(i32, i32)> = upper.chain(lower).collect();
                paper.draw(&Polygon::new(outline, line.colour.mix(0.28).filled()))?;
            }
        }
        let pen: ShapeStyle = line.colour.stroke_width(if mark.is_none() { 4 } else { 6 });
        for piece in pieces() {
            if let [one] = piece {
                paper.draw(&Circle::new((x(one), y(one.median)), 7, line.colour.filled()))?;
                continue;
            }
            let path: Vec<(i32, i32)> = piece.iter().map(|column| (x(column), y(column.median))).collect();
            paper.draw(&PathElement::new(path, pen))?;
        }
        let Some((mark, aside)) = mark.zip(self.stages.iter().position(|other| other == line)) else {
            return Ok(());
        };
        // Aside from those of other stages, so that none hides another.
        let apart = (count / MARKS).max(1);
        for column in columns.chunk_by(|a, b| a.number / apart == b.number / apart) {
            if let Some(column) = column.get(column.len() * (aside + 1) / (STAGES + 1)) {
                mark.draw(paper, (x(column), y(column.median)), line.colour)?;
            }
        }
        Ok(())
    }

    fn draw_unanswered<DB: DrawingBackend>(&self, paper: &Paper<DB>, frame: &Frame) -> Drawn<DB> {
        if self.unanswered.is_empty() {
            return Ok(());
        }
        let y = frame.y.pixels.1 - RAIL / 2;
        let rail = [(frame.x.pixels.0, y), (frame.x.pixels.1, y)];
        paper.draw(&PathElement::new(rail, GRID.stroke_width(3)))?;
        // Those that would lie on one another are one.
        let mut places: Vec<i32> = self.unanswered.iter().map(|at| frame.x.at(*at) / COLUMN).collect();
        places.sort_unstable();
        places.dedup();
        for place in places {
            Mark::Cross.draw(paper, (place * COLUMN, y), LOST)?;
        }
        Ok(())
    }

    /// `12 beyond 90 ms ↑`: how many iterations leave the plot.
    fn remark(&self, frame: &Frame) -> Option<String> {
        let most = frame.y.values.1 / self.unit.per_si;
        let beyond = self.total.values.iter().filter(|(_, value)| *value > most).count();
        let count = fixed(beyond as f64, 0);
        (beyond > 0).then(|| format!("{count} beyond {}", self.unit.words(most, 0.0)))
    }
}

impl Figure for Course {
    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let top = self.header().draw(paper)?;
        let Some((times, shown)) = self.times().zip(self.shown()) else { return nothing(paper, top) };
        let range = (shown.0 * self.unit.per_si, shown.1 * self.unit.per_si);
        // Between the title of the vertical axis and the plot.
        let rail = if self.unanswered.is_empty() { 0 } else { RAIL };
        let y = Frame::below(top + rail, SIZE.1 as i32, |pixels| Axis::from_zero(range, pixels));
        let x = Axis::linear(times, Frame::beside(&y, SIZE.0 as i32));
        let x = if self.is_counted { x.whole() } else { x };
        let frame = Frame { x, y };
        self.draw_ground(paper, &frame)?;
        frame.draw_y(paper, (&self.unit.title, rail))?;
        self.draw_line(paper, &frame, (&self.total, None))?;
        for (number, line) in self.stages.iter().enumerate() {
            self.draw_line(paper, &frame, (line, Some(Mark::ALL[number % 4])))?;
        }
        self.draw_unanswered(paper, &frame)?;
        if let Some(remark) = self.remark(&frame) {
            frame.remark(paper, (&remark, rail))?;
        }
        frame.draw_x(paper, &self.x, |tick| tick.text.clone())
    }
}
