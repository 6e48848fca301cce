//! Numbers of the points, each placed without overlap, with a thin line to its point if it is not next to it.

use super::{CAP_HALF_WIDTH, RADIUS, Spot};
use crate::look::{INK_2, Style, TextStyle};
use crate::plot::{Anchor, At, Item, Label};
use crate::sheet::file::{Area, SMALL, TEXT, WIDTH};
use crate::text::width;

/// Half the height of a number, points.
const HALF_HEIGHT: f64 = 3.6;
/// Distance from a point to its number, points.
const GAP: f64 = RADIUS + 0.9;
/// Minimum distance between two numbers, so that they are not read as one, points.
const MIN_DISTANCE: f64 = 2.1;
/// Distance below which two points are neighbours: their numbers are on the sides away from each other, points.
const NEIGHBOUR_DISTANCE: f64 = 13.5;
/// Height above the plot that numbers may use, next to the title of its axis, points.
const HEIGHT_ABOVE_PLOT: f64 = 11.0;
/// Minimum distance between a number and the limit of its area, points.
const EDGE_DISTANCE: f64 = 0.6;

/// Left, top, right, bottom; points.
type Rect = [f64; 4];

/// Point with its whiskers in the file's coordinates, points.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Placed {
    at: (f64, f64),
    interval: (f64, f64),
    p95: Option<f64>,
}

/// Lays the numbers out in a plot that has this area and this title above.
pub(super) fn items(area: &Area, spots: &[Spot], title: &str) -> Vec<Item> {
    let placed: Vec<Placed> = spots.iter().map(|spot| Placed::of(spot, area)).collect();
    let within = [
        area.left + EDGE_DISTANCE,
        area.top - HEIGHT_ABOVE_PLOT,
        WIDTH - 2.0 * EDGE_DISTANCE,
        area.top + area.height - EDGE_DISTANCE,
    ];
    let mut taken: Vec<Rect> = placed.iter().flat_map(Placed::boxes).collect();
    taken.push([0.0, 0.0, 2.0 * MIN_DISTANCE + width(title, TEXT), area.top - 2.0]);
    let share = |x: f64, y: f64| At::new((x - area.left) / area.width, (y - area.top) / area.height);
    let mut items = Vec::new();
    for (index, spot) in placed.iter().enumerate() {
        let number = (index + 1).to_string();
        let places = spot.places(width(&number, SMALL), spot.side(&placed));
        let is_astray = |place: &Rect| spot.is_farther(place, &placed);
        let Some(place) = free(places, (within, &taken), is_astray) else { continue };
        let middle = (f64::midpoint(place[0], place[2]), f64::midpoint(place[1], place[3]));
        let nearest = (
            spot.at.0.clamp(place[0] - EDGE_DISTANCE, place[2] + EDGE_DISTANCE),
            spot.at.1.clamp(place[1], place[3]),
        );
        let apart = (nearest.0 - spot.at.0).abs().max((nearest.1 - spot.at.1).abs());
        if apart > GAP + EDGE_DISTANCE {
            let leader = Style::line("faint", INK_2.light, 0.3);
            items.push(Item::line(share(spot.at.0, spot.at.1), share(nearest.0, nearest.1), leader));
        }
        let label = Label::new(share(middle.0, middle.1), number, TextStyle::MARK);
        items.push(Item::Text(label.anchored(Anchor::Middle)));
        taken.push([place[0] - MIN_DISTANCE, place[1], place[2] + MIN_DISTANCE, place[3]]);
    }
    items
}

impl Placed {
    fn of(spot: &Spot, area: &Area) -> Self {
        let y = |share: f64| area.top + area.height * share;
        let p95 = spot.p95.map(|share| area.left + area.width * share);
        Self { at: area.point(spot.at), interval: (y(spot.interval.0), y(spot.interval.1)), p95 }
    }

    /// Returns the areas of the point and its two whiskers.
    fn boxes(&self) -> [Rect; 3] {
        let ((x, y), (bottom, top)) = (self.at, self.interval);
        [
            [x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS],
            [x, y - CAP_HALF_WIDTH, self.p95.unwrap_or(x), y + CAP_HALF_WIDTH],
            [x - CAP_HALF_WIDTH, top, x + CAP_HALF_WIDTH, bottom],
        ]
    }

    /// Returns whether the area of a number is at least as near to another point as to this point, so that it would be read as the number of
    /// the other point.
    fn is_farther(&self, place: &Rect, all: &[Self]) -> bool {
        let to =
            |spot: &Self| spot.boxes().iter().map(|area| between(place, area)).fold(f64::INFINITY, f64::min);
        let own = to(self);
        all.iter().any(|other| !std::ptr::eq(other, self) && other.at != self.at && to(other) <= own)
    }

    /// Returns the side with fewer neighbours: 1 to the right, −1 to the left.
    fn side(&self, all: &[Self]) -> f64 {
        let near = all.iter().filter(|other| {
            let apart = (other.at.0 - self.at.0, other.at.1 - self.at.1);
            apart.0.abs() < NEIGHBOUR_DISTANCE && apart.1.abs() < NEIGHBOUR_DISTANCE && apart.0 != 0.0
        });
        let right: f64 = near.map(|other| (other.at.0 - self.at.0).signum()).sum();
        if right > 0.0 { -1.0 } else { 1.0 }
    }

    /// Returns the possible areas of the point's number, the best first. They are around the point; nearer areas are before farther areas, and
    /// areas on the given side before areas on the other side.
    fn places(&self, wide: f64, side: f64) -> impl Iterator<Item = Rect> {
        let ((x, y), half) = (self.at, wide / 2.0);
        let around = [(0, -1), (1, -1), (-1, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (0, 1)];
        (0..6).flat_map(move |ring| {
            let ring = f64::from(ring);
            around.map(|(across, down)| {
                let (aside, below) =
                    (GAP + half + ring * (wide + 1.2), GAP + HALF_HEIGHT + ring * 2.0 * HALF_HEIGHT);
                let (middle, level) = (x + side * f64::from(across) * aside, y + f64::from(down) * below);
                [middle - half, level - HALF_HEIGHT, middle + half, level + HALF_HEIGHT]
            })
        })
    }
}

/// Returns the distance of two areas: the larger of the horizontal and the vertical distance.
fn between(a: &Rect, b: &Rect) -> f64 {
    let gap = |low: usize| (a[low] - b[low + 2]).max(b[low] - a[low + 2]).max(0.0);
    gap(0).max(gap(1))
}

/// Returns the first area on the plot that overlaps nothing and is near enough to the point, or otherwise the area with the smallest
/// overlap.
fn free(
    places: impl Iterator<Item = Rect>,
    (within, taken): (Rect, &[Rect]),
    is_astray: impl Fn(&Rect) -> bool,
) -> Option<Rect> {
    let shared = |a: &Rect, b: &Rect| {
        let wide = (a[2].min(b[2]) - a[0].max(b[0])).max(0.0);
        wide * (a[3].min(b[3]) - a[1].max(b[1])).max(0.0)
    };
    let inside = places.filter(|place| {
        place[0] >= within[0] && place[1] >= within[1] && place[2] <= within[2] && place[3] <= within[3]
    });
    let cost = |place: &Rect| taken.iter().map(|other| shared(place, other)).sum::<f64>();
    let ranked = inside.map(|place| (cost(&place), is_astray(&place), place));
    ranked.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).map(|(.., place)| place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn number_is_nearest_to_its_point() {
        let spot =
            |x: f64, reach: f64| Placed { at: (x, 75.0), interval: (75.0 + reach, 75.0 - reach), p95: None };
        let own = spot(75.0, 0.0);
        let beside = spot(75.0 + 1.8 + CAP_HALF_WIDTH, 30.0);
        let spots = [own, beside];
        let taken: Vec<Rect> = spots.iter().flat_map(Placed::boxes).collect();
        let places = || spots[0].places(3.0, spots[0].side(&spots));
        let is_astray = |place: &Rect| spots[0].is_farther(place, &spots);
        let page = ([0.0, 0.0, 150.0, 150.0], taken.as_slice());
        let place = free(places(), page, is_astray).expect("there is room");
        assert!(!is_astray(&place) && place[2] < 75.0 + 1.8, "{place:?}");
        let nearest = free(places(), page, |_| false).expect("there is room");
        assert!(is_astray(&nearest), "the place straight above is nearer to the whisker: {nearest:?}");
    }
}
