//! A plot's axes, drawn.

use plotters::element::PathElement;
use plotters::prelude::DrawingBackend;
use plotters::style::Color;
use plotters::style::text_anchor::{HPos, VPos};

use super::axis::{Axis, Tick};
use super::canvas::{Drawn, Paper, SMALL, TEXT, style};
use super::colour::{AXIS, GRID, QUIET};
use super::text::{text, width};

/// Distance from the edge of the paper, pixels.
pub(super) const EDGE: i32 = 40;
/// Between an axis and its labels.
const GAP: i32 = 18;
/// Room below a plot: labels and the axis' title.
const BELOW: i32 = 170;
/// Room above a plot for the title of the vertical axis.
const ABOVE: i32 = 84;

/// Least distance of the marks of a vertical axis, so that their labels are apart.
const APART: i32 = 80;

/// Where a vertical axis is marked: a low one less often.
fn upward(y: &Axis) -> Vec<Tick> {
    y.ticks(((y.pixels.0 - y.pixels.1) / APART).clamp(1, 5) as u32)
}

/// The two axes of a plot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::drawing) struct Frame {
    pub(in crate::drawing) x: Axis,
    pub(in crate::drawing) y: Axis,
}

impl Frame {
    /// The vertical axis below a header on paper of that height; `of` makes it of its pixels.
    pub(in crate::drawing) fn below(header: i32, height: i32, of: impl FnOnce((i32, i32)) -> Axis) -> Axis {
        of((height - BELOW, header + ABOVE))
    }

    /// From where to where the horizontal axis goes beside a vertical one, on paper of that width.
    pub(in crate::drawing) fn beside(y: &Axis, paper: i32) -> (i32, i32) {
        let widest = upward(y).iter().map(|tick| width(&tick.text, TEXT)).max().unwrap_or_default();
        (EDGE + widest + GAP, paper - EDGE - 20)
    }

    /// Grid, labels and title of the vertical axis; between the plot and its title so many pixels are left free.
    pub(in crate::drawing) fn draw_y<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        (title, free): (&str, i32),
    ) -> Drawn<DB> {
        let (left, right) = self.x.pixels;
        for tick in upward(&self.y) {
            let at = self.y.at(tick.value);
            paper.draw(&PathElement::new([(left, at), (right, at)], GRID.stroke_width(3)))?;
            let look = style(TEXT, QUIET, HPos::Right, VPos::Center);
            text(paper, tick.text, (left - GAP, at), look)?;
        }
        let look = style(TEXT, QUIET, HPos::Left, VPos::Bottom);
        text(paper, self.y.titled(title), (EDGE, self.y.pixels.1 - 20 - free), look)
    }

    /// The horizontal axis' marks through all of the plot.
    pub(in crate::drawing) fn draw_upright_grid<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB> {
        let (bottom, top) = self.y.pixels;
        for tick in self.x.ticks(6) {
            let at = self.x.at(tick.value);
            paper.draw(&PathElement::new([(at, bottom), (at, top)], GRID.stroke_width(3)))?;
        }
        Ok(())
    }

    /// Line, labels and title of the horizontal axis.
    pub(in crate::drawing) fn draw_x<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        title: &str,
        label: impl Fn(&Tick) -> String,
    ) -> Drawn<DB> {
        let ticks = self.x.ticks(6).into_iter();
        let ticks: Vec<Tick> = ticks.map(|tick| Tick { text: label(&tick), ..tick }).collect();
        self.draw_x_at(paper, title, &ticks)
    }

    /// The same with marks of one's own.
    pub(in crate::drawing) fn draw_x_at<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        title: &str,
        ticks: &[Tick],
    ) -> Drawn<DB> {
        self.draw_base(paper, ticks)?;
        let ((left, right), bottom) = (self.x.pixels, self.y.pixels.0);
        let edge = paper.dim_in_pixel().0 as i32 - 8;
        let mut taken = 0;
        for tick in ticks {
            let half = width(&tick.text, TEXT) / 2;
            // A label at the end stays on the paper, and none lies on its neighbour.
            let at = self.x.at(tick.value).min(edge - half);
            if at - half < taken {
                continue;
            }
            taken = at + half + GAP;
            let look = style(TEXT, QUIET, HPos::Center, VPos::Top);
            text(paper, tick.text.clone(), (at, bottom + 24), look)?;
        }
        let look = style(TEXT, QUIET, HPos::Center, VPos::Bottom);
        let below = (i32::midpoint(left, right), bottom + BELOW - 24);
        text(paper, self.x.titled(title), below, look)
    }

    /// The line below a plot and its marks, without labels.
    pub(in crate::drawing) fn draw_base<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        ticks: &[Tick],
    ) -> Drawn<DB> {
        let ((left, right), bottom) = (self.x.pixels, self.y.pixels.0);
        paper.draw(&PathElement::new([(left, bottom), (right, bottom)], AXIS.stroke_width(3)))?;
        for at in ticks.iter().map(|tick| self.x.at(tick.value)) {
            paper.draw(&PathElement::new([(at, bottom), (at, bottom + 12)], AXIS.stroke_width(3)))?;
        }
        Ok(())
    }

    /// A remark above the plot's right end, on the line of the vertical axis' title.
    pub(in crate::drawing) fn remark<DB: DrawingBackend>(
        &self,
        paper: &Paper<DB>,
        (remark, free): (&str, i32),
    ) -> Drawn<DB> {
        let look = style(SMALL, QUIET, HPos::Right, VPos::Bottom);
        text(paper, remark.to_owned(), (self.x.pixels.1, self.y.pixels.1 - 20 - free), look)
    }
}
