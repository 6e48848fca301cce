//! How often answers are right against how long they take.

use plotters::element::PathElement;
use plotters::prelude::DrawingBackend;
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, RGBColor};

use super::histogram::nothing;
use super::kit::{
    Axis, Drawn, Figure, Frame, Header, INK, Mark, Paper, SIZE, SMALL, Unit, shorten, style, text, width,
};
use crate::accuracy;

/// Half the width of a whisker's cap, pixels.
const CAP: i32 = 9;
/// From a point to its label.
const GAP: i32 = 20;
/// Half the height of a label.
const HALF: i32 = 24;
/// Widest label.
const WIDEST: i32 = 620;
/// From this ratio of the largest to the smallest latency on, the axis is logarithmic.
const WIDE: f64 = 12.0;
/// Room beyond the intervals, percentage points.
const ROOM: f64 = 2.0;
const COLOUR: RGBColor = RGBColor(0x0b, 0x47, 0x96);

/// One configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// What it is, for its label.
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
    /// Share of right answers with its 95 % interval: low, share, high, from 0 to 1. `None` without an answer.
    fn accuracy(&self) -> Option<[f64; 3]> {
        let accuracy::Accuracy { share, interval: (low, high), .. } =
            accuracy::Accuracy::of_counts(self.right, self.count, 0)?;
        Some([low, share, high])
    }
}

/// A point for each configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Accuracy {
    /// What is shown.
    pub title: String,
    /// The horizontal axis: a latency.
    pub unit: Unit,
    /// The points; those without an answer or of no latency are left out.
    pub scores: Vec<Score>,
    /// What the whiskers are and so on.
    pub notes: Vec<String>,
}

/// A point on paper: itself, how far up and down its interval goes, where its 95th percentile is.
struct Spot<'a> {
    label: &'a str,
    at: (i32, i32),
    interval: (i32, i32),
    p95: Option<i32>,
}

/// Left, top, right, bottom.
type Area = [i32; 4];

impl Accuracy {
    fn shown(&self) -> impl Iterator<Item = (&Score, [f64; 3])> {
        let finite = self.scores.iter().filter(|score| score.median.is_finite() && score.median > 0.0);
        finite.filter_map(|score| Some((score, score.accuracy()?.map(|share| share * 100.0))))
    }

    fn frame(&self, header: i32) -> Option<Frame> {
        let join = |(lo, hi): (f64, f64), (a, b): (f64, f64)| (lo.min(a), hi.max(b));
        let (low, high) = self.shown().map(|(_, [low, _, high])| (low, high)).reduce(join)?;
        let late = |score: &Score| score.p95.filter(|p95| p95.is_finite()).unwrap_or(score.median);
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
            Axis::from_zero((0.0, slow), pixels)
        };
        Some(Frame { x, y })
    }

    fn spots(&self, frame: &Frame) -> Vec<Spot<'_>> {
        let across = |value: f64| frame.x.at(value * self.unit.per_si);
        let spot = |(score, [low, share, high]): (&'_ Score, [f64; 3])| {
            (
                (across(score.median), frame.y.at(share)),
                (frame.y.at(low), frame.y.at(high)),
                score.p95.filter(|p95| p95.is_finite()).map(across),
            )
        };
        let spots = self.shown().map(|shown| (shown.0, spot(shown)));
        spots.map(|(score, (at, interval, p95))| Spot { label: &score.label, at, interval, p95 }).collect()
    }
}

impl Spot<'_> {
    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let ((x, y), pen) = (self.at, COLOUR.stroke_width(3));
        let (bottom, top) = self.interval;
        paper.draw(&PathElement::new([(x, bottom), (x, top)], pen))?;
        for end in [bottom, top] {
            paper.draw(&PathElement::new([(x - CAP, end), (x + CAP, end)], pen))?;
        }
        if let Some(late) = self.p95 {
            paper.draw(&PathElement::new([(x, y), (late, y)], pen))?;
            paper.draw(&PathElement::new([(late, y - CAP), (late, y + CAP)], pen))?;
        }
        Mark::Disc.draw(paper, self.at, COLOUR)
    }

    /// What the point and its whiskers take.
    fn boxes(&self) -> [Area; 2] {
        let ((x, y), (bottom, top)) = (self.at, self.interval);
        [[x - 16, y - 16, self.p95.unwrap_or(x).max(x + 16), y + 16], [x - CAP, top, x + CAP, bottom]]
    }

    /// Where its label may stand, the best first: beside the point, farther and farther up and down, then at the end of its
    /// whisker.
    fn places(&self, wide: i32) -> impl Iterator<Item = Area> {
        let ((x, y), right) = (self.at, self.p95.unwrap_or(self.at.0).max(self.at.0 + 16));
        let beside = [x - GAP - wide, x + GAP, x - wide / 2, right + GAP];
        let aside = [0, -1, 1, -2, 2, -3, 3, -4, 4].map(|step| step * (HALF + 8));
        aside
            .into_iter()
            .flat_map(move |aside| beside.map(|left| [left, y + aside - HALF, left + wide, y + aside + HALF]))
    }
}

/// The first place on the plot that lies on nothing; else the one that lies on least.
fn free(places: impl Iterator<Item = Area>, within: Area, taken: &[Area]) -> Option<Area> {
    let shared = |a: &Area, b: &Area| {
        let wide = (a[2].min(b[2]) - a[0].max(b[0])).max(0);
        i64::from(wide) * i64::from((a[3].min(b[3]) - a[1].max(b[1])).max(0))
    };
    let inside = places.filter(|place| {
        place[0] >= within[0] && place[1] >= within[1] && place[2] <= within[2] && place[3] <= within[3]
    });
    inside.min_by_key(|place| taken.iter().map(|other| shared(place, other)).sum::<i64>())
}

impl Figure for Accuracy {
    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let header = Header { title: self.title.clone(), keys: Vec::new(), notes: self.notes.clone() };
        let top = header.draw(paper)?;
        let Some(frame) = self.frame(top) else { return nothing(paper, top) };
        frame.draw_y(paper, ("Top-1 accuracy, %", 0))?;
        frame.draw_upright_grid(paper)?;
        frame.draw_x(paper, &self.unit.title, |tick| tick.text.clone())?;
        let spots = self.spots(&frame);
        let mut taken: Vec<Area> = spots.iter().flat_map(Spot::boxes).collect();
        for spot in &spots {
            spot.draw(paper)?;
        }
        let (bottom, top) = frame.y.pixels;
        let within = [frame.x.pixels.0, top, SIZE.0 as i32 - 8, bottom];
        for spot in &spots {
            let label = shorten(spot.label, SMALL, WIDEST);
            let Some(place) = free(spot.places(width(&label, SMALL)), within, &taken) else { continue };
            let at = (place[0], i32::midpoint(place[1], place[3]));
            text(paper, label, at, style(SMALL, INK, HPos::Left, VPos::Center))?;
            taken.push(place);
        }
        Ok(())
    }
}
