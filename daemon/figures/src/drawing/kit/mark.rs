//! Points that differ without colour.

use plotters::element::{Circle, DashedPathElement, PathElement, Polygon, Rectangle, TriangleMarker};
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor};

use super::canvas::{Drawn, Paper};

/// Width of the line of a series, pixels.
const LINE: u32 = 5;

/// How the points and the line of a series look, so that they differ without colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Discs on a solid line.
    Disc,
    /// Triangles on a dashed line.
    Triangle,
    /// Squares on a dotted line.
    Square,
    /// Diamonds on a line of long dashes.
    Diamond,
    /// Crosses: where something is missing.
    Cross,
}

impl Mark {
    /// Those of series, in the order in which they are taken.
    pub const ALL: [Self; 4] = [Self::Disc, Self::Triangle, Self::Square, Self::Diamond];

    /// Draws the line of its series through some points.
    pub(in crate::drawing) fn draw_line<DB: DrawingBackend>(
        self,
        paper: &Paper<DB>,
        points: Vec<(i32, i32)>,
        colour: RGBColor,
    ) -> Drawn<DB> {
        if points.len() < 2 {
            return Ok(());
        }
        let pen = colour.stroke_width(LINE);
        let (dash, gap) = match self {
            Self::Disc | Self::Cross => return paper.draw(&PathElement::new(points, pen)),
            Self::Triangle => (22, 16),
            Self::Square => (7, 11),
            Self::Diamond => (44, 14),
        };
        paper.draw(&DashedPathElement::new(points, dash, gap, pen))
    }

    /// Draws a series: its line and itself around each point.
    pub(in crate::drawing) fn draw_curve<DB: DrawingBackend>(
        self,
        paper: &Paper<DB>,
        points: Vec<(i32, i32)>,
        colour: RGBColor,
    ) -> Drawn<DB> {
        self.draw_line(paper, points.clone(), colour)?;
        points.into_iter().try_for_each(|point| self.draw(paper, point, colour))
    }

    /// Draws it around a point.
    pub(in crate::drawing) fn draw<DB: DrawingBackend>(
        self,
        paper: &Paper<DB>,
        (x, y): (i32, i32),
        colour: RGBColor,
    ) -> Drawn<DB> {
        let style = colour.filled();
        match self {
            Self::Cross => {
                let pen = colour.stroke_width(6);
                paper.draw(&PathElement::new([(x - 13, y - 13), (x + 13, y + 13)], pen))?;
                paper.draw(&PathElement::new([(x - 13, y + 13), (x + 13, y - 13)], pen))
            }
            Self::Disc => paper.draw(&Circle::new((x, y), 12, style)),
            Self::Triangle => paper.draw(&TriangleMarker::new((x, y), 16, style)),
            Self::Square => paper.draw(&Rectangle::new([(x - 11, y - 11), (x + 11, y + 11)], style)),
            Self::Diamond => {
                paper.draw(&Polygon::new([(x - 16, y), (x, y - 16), (x + 16, y), (x, y + 16)], style))
            }
        }
    }
}
