//! Areas that differ without colour.

use plotters::element::{PathElement, Rectangle};
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor, WHITE};

use super::canvas::{Drawn, Paper};

/// Distance between the lines of a hatch, pixels.
const STEP: i32 = 26;

/// The lines over an area.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hatch {
    /// None.
    Plain,
    /// `/`
    Rising,
    /// `\`
    Falling,
    /// `–`
    Level,
    /// `|`
    Upright,
    /// `×`
    Cross,
}

/// What an area is filled with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fill {
    /// The ground.
    pub colour: RGBColor,
    /// The lines' colour.
    pub line: RGBColor,
    /// The lines' direction.
    pub hatch: Hatch,
}

impl Fill {
    /// A dark ground with white lines.
    pub const fn dark(colour: RGBColor, hatch: Hatch) -> Self {
        Self { colour, line: WHITE, hatch }
    }

    /// A pale ground with darker lines.
    pub const fn pale(colour: RGBColor, line: RGBColor, hatch: Hatch) -> Self {
        Self { colour, line, hatch }
    }
}

/// Fills a rectangle, from its left upper to its right lower corner.
pub(in crate::drawing) fn fill<DB: DrawingBackend>(
    paper: &Paper<DB>,
    [from, to]: [(i32, i32); 2],
    fill: Fill,
) -> Drawn<DB> {
    paper.draw(&Rectangle::new([from, to], fill.colour.filled()))?;
    for line in lines(from, to, fill.hatch) {
        paper.draw(&PathElement::new(line, fill.line.stroke_width(3)))?;
    }
    if fill.line != WHITE {
        paper.draw(&Rectangle::new([from, to], fill.line.stroke_width(2)))?;
    }
    Ok(())
}

/// The lines of a hatch, on one grid for all of the paper.
fn lines((left, top): (i32, i32), (right, bottom): (i32, i32), hatch: Hatch) -> Vec<[(i32, i32); 2]> {
    // A line that only touches a corner or runs along an edge is none.
    let between = |lo: i32, hi: i32, step: i32| {
        let first = (lo + 2).div_euclid(step) * step;
        (first..hi - 1).step_by(step as usize).filter(move |at| *at > lo + 1)
    };
    // Equally close for the eye, whatever the direction.
    let slanted = STEP * 7 / 5;
    let rising = || {
        between(left + top, right + bottom, slanted).map(|sum| {
            [(left.max(sum - bottom), bottom.min(sum - left)), (right.min(sum - top), top.max(sum - right))]
        })
    };
    let falling = || {
        between(left - bottom, right - top, slanted).map(|less| {
            [
                (left.max(top + less), top.max(left - less)),
                (right.min(bottom + less), bottom.min(right - less)),
            ]
        })
    };
    match hatch {
        Hatch::Plain => Vec::new(),
        Hatch::Rising => rising().collect(),
        Hatch::Falling => falling().collect(),
        Hatch::Cross => rising().chain(falling()).collect(),
        Hatch::Level => between(top, bottom, STEP * 2 / 3).map(|y| [(left, y), (right, y)]).collect(),
        Hatch::Upright => between(left, right, STEP * 2 / 3).map(|x| [(x, top), (x, bottom)]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_line_leaves_its_area() {
        let all = [Hatch::Rising, Hatch::Falling, Hatch::Level, Hatch::Upright, Hatch::Cross];
        for (hatch, area) in all.into_iter().flat_map(|hatch| {
            [[(0, 0), (200, 60)], [(133, 777), (140, 1100)], [(5, 5), (5, 5)], [(9, 9), (10, 400)]]
                .map(|area| (hatch, area))
        }) {
            let [(left, top), (right, bottom)] = area;
            let inside = |(x, y): &(i32, i32)| (left..=right).contains(x) && (top..=bottom).contains(y);
            let lines = lines(area[0], area[1], hatch);
            assert!(lines.iter().flatten().all(inside), "{hatch:?} {area:?} {lines:?}");
        }
        assert!(lines((0, 0), (200, 60), Hatch::Rising).len() > 4);
        assert!(lines((0, 0), (200, 60), Hatch::Plain).is_empty());
    }
}
