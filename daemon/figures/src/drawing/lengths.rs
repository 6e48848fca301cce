//! Two quantities of each iteration against each other, with the distribution of each beside: response length and
//! latency.

use peernet_statistics::number::fixed;
use plotters::element::{Circle, Rectangle};
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor};

use std::collections::BTreeMap;

use super::histogram::{Bins, nothing, range};
use super::kit::{Axis, Drawn, Figure, Frame, Header, INK, Paper, SIZE, Unit};
use peernet_analysis::order::Ordered;

/// From how many points on they are counted into cells.
const MANY: usize = 1500;
/// Side of a cell, pixels.
const CELL: i32 = 12;
/// Room for a distribution beside the plot, pixels.
const MARGIN: i32 = 190;
/// Between plot and distribution.
const GAP: i32 = 14;
/// An axis begins at zero unless the smallest value is above this share of the largest.
const CLOSE: f64 = 0.75;
const COLOUR: RGBColor = RGBColor(0x0b, 0x47, 0x96);

/// Points with both marginal histograms.
#[derive(Clone, Debug, PartialEq)]
pub struct Lengths {
    /// What is shown.
    pub title: String,
    /// The horizontal axis.
    pub x: Unit,
    /// The vertical axis.
    pub y: Unit,
    /// One for each iteration, SI units; what is not finite is left out.
    pub points: Vec<(f64, f64)>,
    /// How many there are, what is left out and so on.
    pub notes: Vec<String>,
}

impl Lengths {
    fn along(&self, of: fn(&(f64, f64)) -> f64) -> Ordered {
        let finite = self.points.iter().filter(|(x, y)| x.is_finite() && y.is_finite());
        finite.map(of).collect()
    }

    /// The points that the axes hold, as shown.
    fn inside<'a>(&'a self, frame: &'a Frame) -> impl Iterator<Item = (f64, f64)> + 'a {
        let shown = |(x, y): &(f64, f64)| (x * self.x.per_si, y * self.y.per_si);
        self.points.iter().map(shown).filter(|(x, y)| frame.x.has(*x) && frame.y.has(*y))
    }

    fn draw_points<DB: DrawingBackend>(&self, paper: &Paper<DB>, frame: &Frame) -> Drawn<DB> {
        let places = self.inside(frame).map(|(x, y)| (frame.x.at(x), frame.y.at(y)));
        if self.points.len() <= MANY {
            for place in places {
                paper.draw(&Circle::new(place, 9, COLOUR.mix(0.5).filled()))?;
            }
            return Ok(());
        }
        let mut cells: BTreeMap<(i32, i32), u32> = BTreeMap::new();
        for (x, y) in places {
            *cells.entry((x.div_euclid(CELL), y.div_euclid(CELL))).or_default() += 1;
        }
        let most = f64::from(cells.values().copied().max().unwrap_or(1)).ln_1p();
        for ((column, row), count) in cells {
            // One point is seen, and ten times as many are a step darker, however many there are.
            let shade = 0.18 + 0.82 * f64::from(count).ln_1p() / most;
            let corner = (column * CELL, row * CELL);
            let cell = [corner, (corner.0 + CELL, corner.1 + CELL)];
            paper.draw(&Rectangle::new(cell, COLOUR.mix(shade).filled()))?;
        }
        Ok(())
    }

    /// Bars of the values along one axis, in a strip from `base` on to `base + MARGIN`.
    fn draw_margin<DB: DrawingBackend>(
        paper: &Paper<DB>,
        values: &Ordered,
        place: impl Fn(f64, f64, i32) -> [(i32, i32); 2],
    ) -> Drawn<DB> {
        let Some(bins) = Bins::of(values) else { return Ok(()) };
        let highest = bins.highest().max(1) as f64;
        for (number, count) in bins.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (from, to) = bins.bin(number);
            let length = ((*count as f64 / highest * f64::from(MARGIN)) as i32).max(3);
            paper.draw(&Rectangle::new(place(from, to, length), INK.mix(0.55).filled()))?;
        }
        Ok(())
    }
}

/// Whether an axis from zero would squeeze all values between these into a corner.
pub fn would_squeeze(lo: f64, hi: f64) -> bool {
    hi > lo && lo > hi * CLOSE
}

fn axis((lo, hi): (f64, f64), per_si: f64, pixels: (i32, i32)) -> Axis {
    let (lo, hi) = (lo * per_si, hi * per_si);
    let room = (hi - lo) * 0.05;
    if would_squeeze(lo, hi) {
        Axis::linear((lo - room, hi + room), pixels)
    } else {
        Axis::from_zero((lo, hi), pixels)
    }
}

impl Figure for Lengths {
    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let header = Header { title: self.title.clone(), keys: Vec::new(), notes: self.notes.clone() };
        let top = header.draw(paper)?;
        let (xs, ys) = (self.along(|(x, _)| *x), self.along(|(_, y)| *y));
        let Some((across, up)) = range(&xs).zip(range(&ys)) else { return nothing(paper, top) };
        let y = Frame::below(top + MARGIN + GAP, SIZE.1 as i32, |pixels| axis(up, self.y.per_si, pixels));
        let (left, right) = Frame::beside(&y, SIZE.0 as i32);
        let x = axis(across, self.x.per_si, (left, right - MARGIN - GAP));
        let frame = Frame { x, y };
        frame.draw_y(paper, (&self.y.title, MARGIN + GAP))?;
        frame.draw_upright_grid(paper)?;
        self.draw_points(paper, &frame)?;
        let beyond = self.points.len() - self.inside(&frame).count();
        if beyond > 0 {
            let remark = format!("{} beyond the axes", fixed(beyond as f64, 0));
            frame.remark(paper, (&remark, MARGIN + GAP))?;
        }
        frame.draw_x(paper, &self.x.title, |tick| tick.text.clone())?;
        let (base, side) = (y.pixels.1 - GAP, x.pixels.1 + GAP);
        Self::draw_margin(paper, &xs, |from, to, length| {
            let (from, to) = (x.at(from * self.x.per_si), x.at(to * self.x.per_si));
            [(from + 1, base - length), ((to - 1).max(from + 3), base)]
        })?;
        Self::draw_margin(paper, &ys, |from, to, length| {
            let (from, to) = (y.at(from * self.y.per_si), y.at(to * self.y.per_si));
            [(side, to + 1), (side + length, (from - 1).max(to + 3))]
        })
    }
}
