//! Shapes of points, by which series differ without colour.

/// Shape of the points of a series. The line of the series has a dash that belongs to the shape.
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
    /// Cross, for failed iterations and for the curve of a total.
    Cross,
}

impl Mark {
    /// Marks of series, in the order of their use: all marks except the cross.
    pub const OF_SERIES: [Self; 4] = [Self::Disc, Self::Triangle, Self::Square, Self::Diamond];

    /// Returns the dash and the gap of the mark's line, points; `None` for a solid line.
    pub const fn dash(self) -> Option<(f64, f64)> {
        match self {
            Self::Disc | Self::Cross => None,
            Self::Triangle => Some((3.3, 2.4)),
            Self::Square => Some((1.1, 1.6)),
            Self::Diamond => Some((6.6, 2.1)),
        }
    }

    /// Returns the corners of the mark around its middle, for a radius of 1. A disc has no corners. The corners of a
    /// cross are the ends of its two strokes.
    pub(crate) const fn corners(self) -> &'static [(f64, f64)] {
        match self {
            Self::Disc => &[],
            Self::Triangle => &[(0.0, -1.3), (1.13, 0.65), (-1.13, 0.65)],
            Self::Square => &[(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)],
            Self::Diamond => &[(-1.3, 0.0), (0.0, -1.3), (1.3, 0.0), (0.0, 1.3)],
            Self::Cross => &[(-1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (1.0, -1.0)],
        }
    }
}
