//! Points that differ without colour.

use plotters::element::{Circle, PathElement, Polygon, Rectangle, TriangleMarker};
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor};

use super::canvas::{Drawn, Paper};

/// How the points and the line of a series look, so that they differ without colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Discs on a solid line.
    Disc,
    /// Triangles on a dashed line.
    Triangle,
    /// Squares on a dashed line.
    Square,
    /// Diamonds on a dashed line.
    Diamond,
    /// Crosses: where something is missing.
    Cross,
}

impl Mark {
    /// Those of series, in the order in which they are taken.
    pub const ALL: [Self; 4] = [Self::Disc, Self::Triangle, Self::Square, Self::Diamond];

    /// Draws it around a point.
    pub(in crate::figure) fn draw<DB: DrawingBackend>(
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
