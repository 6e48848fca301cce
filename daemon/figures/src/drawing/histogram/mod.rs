//! How one quantity is distributed.

mod bins;

pub use bins::Bins;
pub(super) use bins::range;

use peernet_statistics::number::fixed;
use plotters::element::{DashedPathElement, PathElement};
use plotters::prelude::DrawingBackend;
use plotters::style::Color;
use plotters::style::text_anchor::{HPos, VPos};

use super::kit::{
    Axis, Drawn, Figure, Fill, Frame, Header, INK, Key, Paper, QUIET, SIZE, Swatch, TEXT, Unit, fill, style,
    text,
};
use peernet_analysis::order::Ordered;

/// Half the width of the only bar, as a part of the plot.
const ALONE: i32 = 20;

/// A histogram with its median and 95th percentile.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// What it is of.
    pub title: String,
    /// What stands along the horizontal axis.
    pub unit: Unit,
    /// What the bars are filled with.
    pub fill: Fill,
    /// The values, SI units.
    pub values: Ordered,
    /// How many values there are, what is left out and so on.
    pub notes: Vec<String>,
}

impl Histogram {
    /// What has a line of its own: its name, where it is, whether the line is dashed.
    fn lines(&self) -> impl Iterator<Item = (&'static str, f64, bool)> {
        let lines = [("median", self.values.median(), false), ("p95", self.values.p95(), true)];
        lines.into_iter().filter_map(|(name, value, dashed)| Some((name, value?, dashed)))
    }

    fn keys(&self) -> Vec<Key> {
        let spread = range(&self.values).map_or(0.0, |(lo, hi)| hi - lo);
        let key = |(name, value, dashed)| {
            Key::new(Swatch::Line(INK, dashed), format!("{name} {}", self.unit.words(value, spread)))
        };
        self.lines().map(key).collect()
    }

    /// What lies outside: `← 3 below 1.2 ms · 12 beyond 23.2 ms →`.
    fn remark(&self, bins: &Bins) -> String {
        let (below, above) = bins.beyond;
        let below =
            (below > 0).then(|| format!("← {} below {}", count(below), self.unit.words(bins.from, 0.0)));
        let above =
            (above > 0).then(|| format!("{} beyond {} →", count(above), self.unit.words(bins.to(), 0.0)));
        [below, above].into_iter().flatten().collect::<Vec<_>>().join(" · ")
    }

    fn frame(&self, header: i32, bins: &Bins) -> Frame {
        let per_si = self.unit.per_si;
        let highest = bins.highest() as f64;
        let y = Frame::below(header, SIZE.1 as i32, |pixels| Axis::from_zero((0.0, highest), pixels).whole());
        let pixels = Frame::beside(&y, SIZE.0 as i32);
        let shown = if bins.counts.len() == 1 {
            // One value alone stands in the middle, not all over the plot.
            let value = f64::midpoint(bins.from, bins.to());
            Axis::linear((value * per_si, value * per_si), pixels)
        } else {
            Axis::linear((bins.from * per_si, bins.to() * per_si), pixels)
        };
        Frame { x: shown, y }
    }
}

impl Figure for Histogram {
    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let header = Header { title: self.title.clone(), keys: self.keys(), notes: self.notes.clone() };
        let top = header.draw(paper)?;
        let Some(bins) = Bins::of(&self.values) else { return nothing(paper, top) };
        let frame = self.frame(top, &bins);
        frame.draw_y(paper, ("Iterations", 0))?;
        let remark = self.remark(&bins);
        if !remark.is_empty() {
            frame.remark(paper, (&remark, 0))?;
        }
        let x = |value: f64| frame.x.at(value * self.unit.per_si);
        let bottom = frame.y.pixels.0;
        for (number, count) in bins.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (from, to) = bins.bin(number);
            // What is there is seen, be it one iteration in ten thousand.
            let height = frame.y.at(*count as f64).min(bottom - 3);
            let (left, right) = if bins.counts.len() == 1 {
                // As wide for zero, which has no width to go by, as for any other value.
                let (left, right) = frame.x.pixels;
                let (middle, half) = (i32::midpoint(left, right), (right - left) / ALONE);
                (middle - half, middle + half)
            } else {
                (x(from), x(to))
            };
            fill(paper, [(left + 1, height), ((right - 2).max(left + 3), bottom)], self.fill)?;
        }
        frame.draw_x(paper, &self.unit.title, |tick| tick.text.clone())?;
        for (_, value, dashed) in self.lines().filter(|(_, value, _)| frame.x.has(value * self.unit.per_si)) {
            let line = [(x(value), bottom), (x(value), frame.y.pixels.1)];
            // A light rim parts the line from the bars behind it.
            paper.draw(&PathElement::new(line, plotters::style::WHITE.mix(0.6).stroke_width(12)))?;
            if dashed {
                paper.draw(&DashedPathElement::new(line, 22, 12, INK.stroke_width(6)))?;
            } else {
                paper.draw(&PathElement::new(line, INK.stroke_width(6)))?;
            }
        }
        Ok(())
    }
}

/// Instead of a plot, where there is nothing to be drawn.
pub(super) fn nothing<DB: DrawingBackend>(paper: &Paper<DB>, top: i32) -> Drawn<DB> {
    let (width, height) = paper.dim_in_pixel();
    let at = (width as i32 / 2, i32::midpoint(top, height as i32));
    text(paper, "no values", at, style(TEXT, QUIET, HPos::Center, VPos::Center))
}

fn count(count: u64) -> String {
    fixed(count as f64, 0)
}
