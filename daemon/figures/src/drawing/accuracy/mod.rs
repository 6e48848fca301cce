//! How often answers are right against how long they take.

mod key;
mod numbers;

use plotters::element::{Circle, PathElement};
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor, WHITE};

use super::histogram::nothing;
use super::kit::{Axis, Drawn, Figure, Frame, Header, Paper, SIZE, TEXT, Unit, width};
use peernet_analysis::accuracy;

/// Half the width of a whisker's cap, pixels.
const CAP: i32 = 9;
/// Radius of a point, with the rim that parts it from its neighbours.
const RADIUS: i32 = 14;
/// From this ratio of the largest to the smallest latency on, the axis is logarithmic.
const WIDE: f64 = 12.0;
/// Room beyond the intervals, percentage points.
const ROOM: f64 = 2.0;
/// Whiskers across lie on one another where their accuracies differ by less than this share of the axis.
const SAME: f64 = 0.03;
const COLOUR: RGBColor = RGBColor(0x0b, 0x47, 0x96);

/// One configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// What it is, for the key.
    pub label: String,
    /// How many answers were right.
    pub right: u64,
    /// Of how many.
    pub count: u64,
    /// Median latency, seconds.
    pub median: f64,
    /// The 95th percentile, seconds; `None` of few values.
    pub p95: Option<f64>,
}

impl Score {
    /// Right answers with their 95 % interval: low, share, high, in per cent. `None` without an answer.
    fn accuracy(&self) -> Option<[f64; 3]> {
        let accuracy::Accuracy { share, interval: (low, high), .. } =
            accuracy::Accuracy::of_counts(self.right, self.count, 0)?;
        Some([low, share, high].map(|share| share * 100.0))
    }

    fn late(&self) -> Option<f64> {
        self.p95.filter(|p95| p95.is_finite())
    }
}

/// A numbered point for each configuration, and a key to the numbers below.
#[derive(Clone, Debug, PartialEq)]
pub struct Accuracy {
    /// What is shown.
    pub title: String,
    /// The horizontal axis: a latency.
    pub unit: Unit,
    /// The points; those without an answer or of no latency are left out.
    pub scores: Vec<Score>,
    /// What is left out and so on.
    pub notes: Vec<String>,
}

/// A point on paper: itself, how far up and down its interval goes, where its 95th percentile is.
struct Spot {
    at: (i32, i32),
    interval: (i32, i32),
    p95: Option<i32>,
}

impl Accuracy {
    fn shown(&self) -> impl Iterator<Item = (&Score, [f64; 3])> {
        let finite = self.scores.iter().filter(|score| score.median.is_finite() && score.median > 0.0);
        finite.filter_map(|score| Some((score, score.accuracy()?)))
    }

    /// From the lowest to the highest end of the intervals, per cent.
    fn heights(&self) -> Option<(f64, f64)> {
        self.shown().map(|(_, [low, _, high])| (low, high)).reduce(join)
    }

    /// Whether there are whiskers across: all or, where two would lie on one another, none.
    fn has_whiskers(&self) -> bool {
        let Some((low, high)) = self.heights() else { return false };
        let near = (high - low + 2.0 * ROOM) * SAME;
        let reach = |score: &Score| (score.median, score.late().unwrap_or(score.median));
        let shown: Vec<((f64, f64), f64)> =
            self.shown().map(|(score, [_, share, _])| (reach(score), share)).collect();
        let touch = |((from, to), share): &((f64, f64), f64), ((other, late), level): &((f64, f64), f64)| {
            (share - level).abs() < near && from <= late && other <= to
        };
        let alone = |(number, one)| shown[number + 1..].iter().all(|other| !touch(one, other));
        shown.iter().enumerate().all(alone) && self.shown().any(|(score, _)| score.late().is_some())
    }

    fn header(&self) -> Header {
        let across = if self.has_whiskers() { " · across: to the 95th percentile" } else { "" };
        let parts = format!("point: median · upright: 95 % interval (Wilson){across}");
        let notes = std::iter::once(parts).chain(self.notes.iter().cloned());
        Header { title: self.title.clone(), keys: Vec::new(), notes: notes.collect() }
    }

    fn frame(&self, header: i32) -> Option<Frame> {
        let (low, high) = self.heights()?;
        let late = |score: &Score| score.late().filter(|_| self.has_whiskers()).unwrap_or(score.median);
        let (fast, slow) = self
            .shown()
            .map(|(score, _)| (score.median * self.unit.per_si, late(score) * self.unit.per_si))
            .reduce(join)?;
        // So little beyond 100 that it is not marked: points at the end are whole.
        let edge = (high - low).max(1.0) * 0.04;
        let shares = ((low - ROOM).max(-edge), (high + ROOM).min(100.0 + edge));
        let y = Frame::below(header, SIZE.1 as i32, |pixels| Axis::linear(shares, pixels));
        let pixels = Frame::beside(&y, SIZE.0 as i32);
        let x = if slow > fast * WIDE {
            let room = (slow / fast).powf(0.08);
            Axis::logarithmic((fast / room, slow * room), pixels)
        } else {
            Axis::from_zero((0.0, slow * 1.04), pixels)
        };
        Some(Frame { x, y })
    }

    fn spots(&self, frame: &Frame) -> Vec<Spot> {
        let across = |value: f64| frame.x.at(value * self.unit.per_si);
        let has_whiskers = self.has_whiskers();
        let spot = |(score, [low, share, high]): (&Score, [f64; 3])| Spot {
            at: (across(score.median), frame.y.at(share)),
            interval: (frame.y.at(low), frame.y.at(high)),
            p95: score.late().filter(|_| has_whiskers).map(across),
        };
        self.shown().map(spot).collect()
    }
}

fn join((lo, hi): (f64, f64), (a, b): (f64, f64)) -> (f64, f64) {
    (lo.min(a), hi.max(b))
}

impl Spot {
    fn draw_whiskers<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let ((x, y), pen) = (self.at, COLOUR.mix(0.5).stroke_width(3));
        let (bottom, top) = self.interval;
        paper.draw(&PathElement::new([(x, bottom), (x, top)], pen))?;
        for end in [bottom, top] {
            paper.draw(&PathElement::new([(x - CAP, end), (x + CAP, end)], pen))?;
        }
        let Some(late) = self.p95 else { return Ok(()) };
        paper.draw(&PathElement::new([(x, y), (late, y)], pen))?;
        paper.draw(&PathElement::new([(late, y - CAP), (late, y + CAP)], pen))
    }

    fn draw_point<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        paper.draw(&Circle::new(self.at, RADIUS, WHITE.filled()))?;
        paper.draw(&Circle::new(self.at, RADIUS - 3, COLOUR.filled()))
    }
}

impl Figure for Accuracy {
    fn size(&self) -> (u32, u32) {
        (SIZE.0, SIZE.1 + self.key_height() as u32)
    }

    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let top = self.header().draw(paper)?;
        let Some(frame) = self.frame(top) else { return nothing(paper, top) };
        let title = "Top-1 accuracy, %";
        frame.draw_y(paper, (title, 0))?;
        frame.draw_upright_grid(paper)?;
        frame.draw_x(paper, &self.unit.title, |tick| tick.text.clone())?;
        let spots = self.spots(&frame);
        spots.iter().try_for_each(|spot| spot.draw_whiskers(paper))?;
        numbers::draw(paper, &frame, (&spots, width(title, TEXT)))?;
        spots.iter().try_for_each(|spot| spot.draw_point(paper))?;
        self.draw_key(paper, SIZE.1 as i32)
    }
}
