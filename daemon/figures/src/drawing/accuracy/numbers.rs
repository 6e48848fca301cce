//! The numbers of the points, each where it lies on nothing, with a thin line to its point where it is not beside it.

use plotters::element::PathElement;
use plotters::prelude::DrawingBackend;
use plotters::style::Color;
use plotters::style::text_anchor::{HPos, VPos};

use super::super::kit::{Drawn, Frame, INK, Paper, QUIET, SIZE, SMALL, style, text, width};
use super::key::EDGE;
use super::{CAP, RADIUS, Spot};

/// Half the height of a number.
const HALF: i32 = 24;
/// From a point to its number.
const GAP: i32 = RADIUS + 6;
/// Between two numbers, so that they are not read as one.
const APART: i32 = 14;
/// Points that are nearer to each other have their numbers on the sides that look away.
const NEAR: i32 = 90;
/// How far numbers go above the plot, beside the title of its axis.
const ABOVE: i32 = 76;

/// Left, top, right, bottom.
type Area = [i32; 4];

/// Draws them; the title above the plot is so wide.
pub(super) fn draw<DB: DrawingBackend>(
    paper: &Paper<DB>,
    frame: &Frame,
    (spots, title): (&[Spot], i32),
) -> Drawn<DB> {
    let (bottom, top) = frame.y.pixels;
    let within = [frame.x.pixels.0 + 4, top - ABOVE, SIZE.0 as i32 - 8, bottom - 4];
    let mut taken: Vec<Area> = spots.iter().flat_map(Spot::boxes).collect();
    taken.push([0, 0, EDGE + title, top - 12]);
    for (index, spot) in spots.iter().enumerate() {
        let number = (index + 1).to_string();
        let places = spot.places(width(&number, SMALL), spot.side(spots));
        let is_astray = |place: &Area| spot.is_farther(place, spots);
        let Some(place) = free(places, (within, &taken), is_astray) else { continue };
        let middle = (i32::midpoint(place[0], place[2]), i32::midpoint(place[1], place[3]));
        let nearest = (spot.at.0.clamp(place[0] - 4, place[2] + 4), spot.at.1.clamp(place[1], place[3]));
        let apart = (nearest.0 - spot.at.0).abs().max((nearest.1 - spot.at.1).abs());
        if apart > GAP + 4 {
            paper.draw(&PathElement::new([spot.at, nearest], QUIET.stroke_width(2)))?;
        }
        text(paper, number, middle, style(SMALL, INK, HPos::Center, VPos::Center))?;
        taken.push([place[0] - APART, place[1], place[2] + APART, place[3]]);
    }
    Ok(())
}

impl Spot {
    /// What the point and its whiskers take.
    fn boxes(&self) -> [Area; 3] {
        let ((x, y), (bottom, top)) = (self.at, self.interval);
        [
            [x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS],
            [x, y - CAP, self.p95.unwrap_or(x), y + CAP],
            [x - CAP, top, x + CAP, bottom],
        ]
    }

    /// Whether a place is as near to another one as to this: the number would be read as that one's.
    fn is_farther(&self, place: &Area, all: &[Self]) -> bool {
        let to = |spot: &Self| spot.boxes().iter().map(|area| between(place, area)).min().unwrap_or_default();
        let own = to(self);
        all.iter().any(|other| !std::ptr::eq(other, self) && other.at != self.at && to(other) <= own)
    }

    /// The side away from most of its neighbours: 1 to the right, −1 to the left.
    fn side(&self, all: &[Self]) -> i32 {
        let near = all.iter().filter(|other| {
            let apart = (other.at.0 - self.at.0, other.at.1 - self.at.1);
            apart.0.abs() < NEAR && apart.1.abs() < NEAR
        });
        let right: i32 = near.map(|other| (other.at.0 - self.at.0).signum()).sum();
        if right > 0 { -1 } else { 1 }
    }

    /// Where its number may stand, the best first: around the point, nearer before farther, that side before the other.
    fn places(&self, wide: i32, side: i32) -> impl Iterator<Item = Area> {
        let ((x, y), half) = (self.at, wide / 2);
        let around = [(0, -1), (1, -1), (-1, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (0, 1)];
        (0..6).flat_map(move |ring| {
            around.map(|(across, down)| {
                let (aside, below) = (GAP + half + ring * (wide + 8), GAP + HALF + ring * 2 * HALF);
                let (middle, level) = (x + side * across * aside, y + down * below);
                [middle - half, level - HALF, middle + half, level + HALF]
            })
        })
    }
}

/// How far two areas are apart, in the direction in which they are farther.
fn between(a: &Area, b: &Area) -> i32 {
    let gap = |low: usize| (a[low] - b[low + 2]).max(b[low] - a[low + 2]).max(0);
    gap(0).max(gap(1))
}

/// The first place on the plot that lies on nothing and is not astray; else the one that lies on least.
fn free(
    places: impl Iterator<Item = Area>,
    (within, taken): (Area, &[Area]),
    is_astray: impl Fn(&Area) -> bool,
) -> Option<Area> {
    let shared = |a: &Area, b: &Area| {
        let wide = (a[2].min(b[2]) - a[0].max(b[0])).max(0);
        i64::from(wide) * i64::from((a[3].min(b[3]) - a[1].max(b[1])).max(0))
    };
    let inside = places.filter(|place| {
        place[0] >= within[0] && place[1] >= within[1] && place[2] <= within[2] && place[3] <= within[3]
    });
    inside.min_by_key(|place| (taken.iter().map(|other| shared(place, other)).sum::<i64>(), is_astray(place)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_nearer_to_its_own_point_than_to_another_ones_whisker() {
        let spot =
            |x: i32, reach: i32| Spot { at: (x, 500), interval: (500 + reach, 500 - reach), p95: None };
        let own = spot(500, 0);
        let beside = spot(500 + 12 + CAP, 200);
        let spots = [own, beside];
        let taken: Vec<Area> = spots.iter().flat_map(Spot::boxes).collect();
        let places = || spots[0].places(20, spots[0].side(&spots));
        let is_astray = |place: &Area| spots[0].is_farther(place, &spots);
        let page = ([0, 0, 1_000, 1_000], taken.as_slice());
        let place = free(places(), page, is_astray).expect("there is room");
        assert!(!is_astray(&place) && place[2] < 500 + 12, "{place:?}");
        let nearest = free(places(), page, |_| false).expect("there is room");
        assert!(is_astray(&nearest), "the place straight above is nearer to the whisker: {nearest:?}");
    }
}
