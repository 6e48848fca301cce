//! The outline of a distribution that stands upright.

use plotters::element::{PathElement, Polygon};
use plotters::prelude::DrawingBackend;
use plotters::style::{Color, RGBColor};

use super::super::kit::{Drawn, Paper};

/// Width of the outline, pixels.
const LINE: u32 = 4;
/// Up to this half width there is no room between two outlines: the shape is a stem. The two sides of a closed outline that
/// lie on each other would leave holes.
const THIN: i32 = 5;

/// Half the width at a height on the paper; from the lowest to the highest.
type Place = (i32, i32);

/// Draws a shape about an upright line.
pub(super) fn draw<DB: DrawingBackend>(
    paper: &Paper<DB>,
    places: &[Place],
    middle: i32,
    colour: RGBColor,
) -> Drawn<DB> {
    let is_stem = |pair: &[Place]| pair.iter().any(|(_, half)| *half <= THIN);
    let pairs: Vec<&[Place]> = places.windows(2).collect();
    for run in pairs.chunk_by(|a, b| is_stem(a) == is_stem(b)) {
        let (first, last) = (run[0][0], run[run.len() - 1][1]);
        if is_stem(run[0]) {
            stem(paper, run, middle, colour)?;
            continue;
        }
        let along = || std::iter::once(first).chain(run.iter().map(|pair| pair[1]));
        let side = |sign: i32| along().map(move |(y, half)| (middle + sign * half, y));
        let outline: Vec<(i32, i32)> =
            side(1).chain(side(-1).collect::<Vec<_>>().into_iter().rev()).collect();
        paper.draw(&Polygon::new(outline, colour.mix(0.35).filled()))?;
        let cap = |(y, half): Place| vec![(middle - half, y), (middle + half, y)];
        let is_end = |place: &Place| places.first() == Some(place) || places.last() == Some(place);
        let caps = [first, last].into_iter().filter(is_end).map(cap);
        for line in [side(1).collect(), side(-1).collect()].into_iter().chain(caps) {
            paper.draw(&PathElement::new::<Vec<(i32, i32)>, _>(line, colour.stroke_width(LINE)))?;
        }
    }
    Ok(())
}

/// A stem as wide as the shape there, at least as an outline.
fn stem<DB: DrawingBackend>(paper: &Paper<DB>, run: &[&[Place]], middle: i32, colour: RGBColor) -> Drawn<DB> {
    let wide = |pair: &[Place]| (2 * pair[0].1.min(pair[1].1)).max(LINE as i32) as u32;
    for part in run.chunk_by(|a, b| wide(a) == wide(b)) {
        let ends = [part[0][0].0, part[part.len() - 1][1].0];
        paper.draw(&PathElement::new(ends.map(|y| (middle, y)), colour.stroke_width(wide(part[0]))))?;
    }
    Ok(())
}
