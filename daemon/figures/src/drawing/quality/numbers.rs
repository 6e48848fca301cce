//! Placement of the numbers of the points. Numbers do not overlap as long as there is room. If a number is not next to
//! its point, a thin line connects the number and the point.

use super::{CAP_HALF_WIDTH, RADIUS, Spot};
use crate::look::{INK_2, Style, TextStyle};
use crate::plot::{Anchor, At, Item, Label};
use crate::render::file::{Area, SMALL, TEXT, WIDTH};
use crate::text::width;

/// Half the height of a number, points.
const HALF_HEIGHT: f64 = 3.6;
/// Distance from a point to its number, points.
const GAP: f64 = RADIUS + 0.9;
/// Minimum distance between two numbers side by side, so that they are not read as one number; points. The distance is
/// generous, because on the narrowest page numbers are almost twice as wide in relation to the plot.
const MIN_DISTANCE: f64 = 4.5;
/// Minimum distance between two numbers above each other, points.
const MIN_DISTANCE_ABOVE: f64 = 2.0;
/// Two points of the figure are neighbours if their horizontal and vertical distances are less than this; points. The
/// numbers of neighbours are on the sides that face away from each other.
const NEIGHBOUR_DISTANCE: f64 = 13.5;
/// Height of the space above the plot that numbers may use, beside the title of the axis, points.
const HEIGHT_ABOVE_PLOT: f64 = 11.0;
/// Minimum distance between a number and the edge of the area for numbers, points.
const EDGE_DISTANCE: f64 = 0.6;

/// Rectangle: left, top, right and bottom, points.
type Rect = [f64; 4];

/// Point with its whiskers in the coordinates of the file, points.
#[derive(Clone, Copy, Debug, PartialEq)]
struct FileSpot {
    at: (f64, f64),
    /// Lower and upper end of the vertical whisker.
    interval: (f64, f64),
    /// Right end of the horizontal whisker; `None` if there is no such whisker.
    p95: Option<f64>,
}

/// Lays the numbers out in a plot. `area` is the area of the plot, and `title` is the text above the plot.
pub(super) fn items(area: &Area, spots: &[Spot], title: &str) -> Vec<Item> {
    let file_spots: Vec<FileSpot> = spots.iter().map(|spot| FileSpot::of(spot, area)).collect();
    let limits = [
        area.left + EDGE_DISTANCE,
        area.top - HEIGHT_ABOVE_PLOT,
        WIDTH - 2.0 * EDGE_DISTANCE,
        area.top + area.height - EDGE_DISTANCE,
    ];
    let mut occupied: Vec<Rect> = file_spots.iter().flat_map(FileSpot::areas).collect();
    // The title above the plot occupies the space that numbers may use beside it.
    occupied.push([0.0, 0.0, 2.0 * MIN_DISTANCE + width(title, TEXT), area.top - 2.0]);
    let at = |x: f64, y: f64| At::new((x - area.left) / area.width, (y - area.top) / area.height);
    let mut items = Vec::new();
    for (index, spot) in file_spots.iter().enumerate() {
        let number = (index + 1).to_string();
        let places = spot.places(width(&number, SMALL), spot.free_side(&file_spots));
        let is_ambiguous = |place: &Rect| spot.is_place_ambiguous(place, &file_spots);
        let Some(place) = best_place(places, (limits, &occupied), is_ambiguous) else { continue };
        let middle = (f64::midpoint(place[0], place[2]), f64::midpoint(place[1], place[3]));
        // Point of the number's rectangle that is nearest to the point of the figure.
        let nearest = (
            spot.at.0.clamp(place[0] - EDGE_DISTANCE, place[2] + EDGE_DISTANCE),
            spot.at.1.clamp(place[1], place[3]),
        );
        let distance = (nearest.0 - spot.at.0).abs().max((nearest.1 - spot.at.1).abs());
        if distance > GAP + EDGE_DISTANCE {
            let line_style = Style::line("faint", INK_2.light, 0.3);
            items.push(Item::line(at(spot.at.0, spot.at.1), at(nearest.0, nearest.1), line_style));
        }
        let label = Label::new(at(middle.0, middle.1), number, TextStyle::MARK);
        items.push(Item::Text(label.anchored(Anchor::Middle)));
        occupied.push([
            place[0] - MIN_DISTANCE,
            place[1] - MIN_DISTANCE_ABOVE,
            place[2] + MIN_DISTANCE,
            place[3] + MIN_DISTANCE_ABOVE,
        ]);
    }
    items
}

impl FileSpot {
    fn of(spot: &Spot, area: &Area) -> Self {
        let y = |share: f64| area.top + area.height * share;
        let p95 = spot.p95.map(|share| area.left + area.width * share);
        Self { at: area.point(spot.at), interval: (y(spot.interval.0), y(spot.interval.1)), p95 }
    }

    /// Returns the areas of the point, of its horizontal whisker and of its vertical whisker.
    fn areas(&self) -> [Rect; 3] {
        let ((x, y), (bottom, top)) = (self.at, self.interval);
        [
            [x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS],
            [x, y - CAP_HALF_WIDTH, self.p95.unwrap_or(x), y + CAP_HALF_WIDTH],
            [x - CAP_HALF_WIDTH, top, x + CAP_HALF_WIDTH, bottom],
        ]
    }

    /// Returns whether a place for this point's number is at least as near to another point as to this point. A reader
    /// would then take the number for the number of the other point.
    fn is_place_ambiguous(&self, place: &Rect, spots: &[Self]) -> bool {
        let distance_to =
            |spot: &Self| spot.areas().iter().map(|area| distance(place, area)).fold(f64::INFINITY, f64::min);
        let own_distance = distance_to(self);
        // No place distinguishes points at the same position, so these points are not compared.
        spots.iter().any(|other| {
            !std::ptr::eq(other, self) && other.at != self.at && distance_to(other) <= own_distance
        })
    }

    /// Returns the side of the point with fewer neighbours: 1 for the right, −1 for the left.
    fn free_side(&self, spots: &[Self]) -> f64 {
        // A point straight above or below is on neither side.
        let neighbours = spots.iter().filter(|other| {
            let distance = (other.at.0 - self.at.0, other.at.1 - self.at.1);
            distance.0.abs() < NEIGHBOUR_DISTANCE
                && distance.1.abs() < NEIGHBOUR_DISTANCE
                && distance.0 != 0.0
        });
        // Number of neighbours at the right minus the number at the left.
        let right_excess: f64 = neighbours.map(|other| (other.at.0 - self.at.0).signum()).sum();
        if right_excess > 0.0 { -1.0 } else { 1.0 }
    }

    /// Returns the possible places of a point's number, the best first. `width` is the width of the number; `side` is 1
    /// for the right, −1 for the left. The places are in rings around the point, nearer rings first. Within a ring,
    /// the places above the point come first, then those beside it, then those below it. Of two places at the same
    /// height, the place on the given side comes first.
    fn places(&self, width: f64, side: f64) -> impl Iterator<Item = Rect> {
        let ((x, y), half_width) = (self.at, width / 2.0);
        let around = [(0, -1), (1, -1), (-1, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (0, 1)];
        (0..6).flat_map(move |ring| {
            let ring = f64::from(ring);
            around.map(|(across, down)| {
                let dx = GAP + half_width + ring * (width + 1.2);
                let dy = GAP + HALF_HEIGHT + ring * 2.0 * HALF_HEIGHT;
                let (middle_x, middle_y) = (x + side * f64::from(across) * dx, y + f64::from(down) * dy);
                [middle_x - half_width, middle_y - HALF_HEIGHT, middle_x + half_width, middle_y + HALF_HEIGHT]
            })
        })
    }
}

/// Returns the distance of two areas: the larger of the horizontal and the vertical distance.
fn distance(a: &Rect, b: &Rect) -> f64 {
    let gap = |low: usize| (a[low] - b[low + 2]).max(b[low] - a[low + 2]).max(0.0);
    gap(0).max(gap(1))
}

/// Returns the place within the limits that overlaps the occupied rectangles least. If several places overlap them
/// equally, an unambiguous place is better than an ambiguous place. Among equally good places, the first place is the
/// best. `None` if no place is within the limits.
fn best_place(
    places: impl Iterator<Item = Rect>,
    (limits, occupied): (Rect, &[Rect]),
    is_ambiguous: impl Fn(&Rect) -> bool,
) -> Option<Rect> {
    let overlap = |a: &Rect, b: &Rect| {
        let width = (a[2].min(b[2]) - a[0].max(b[0])).max(0.0);
        width * (a[3].min(b[3]) - a[1].max(b[1])).max(0.0)
    };
    let inside = places.filter(|place| {
        place[0] >= limits[0] && place[1] >= limits[1] && place[2] <= limits[2] && place[3] <= limits[3]
    });
    let total_overlap = |place: &Rect| occupied.iter().map(|other| overlap(place, other)).sum::<f64>();
    let ranked = inside.map(|place| (total_overlap(&place), is_ambiguous(&place), place));
    ranked.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).map(|(.., place)| place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn number_is_nearer_to_its_point_than_to_others() {
        let spot = |x: f64, half_interval: f64| FileSpot {
            at: (x, 75.0),
            interval: (75.0 + half_interval, 75.0 - half_interval),
            p95: None,
        };
        let own = spot(75.0, 0.0);
        // The caps of the neighbour's whisker begin 1.8 points to the right of the point.
        let neighbour = spot(75.0 + 1.8 + CAP_HALF_WIDTH, 30.0);
        let spots = [own, neighbour];
        let occupied: Vec<Rect> = spots.iter().flat_map(FileSpot::areas).collect();
        let places = || spots[0].places(3.0, spots[0].free_side(&spots));
        let is_ambiguous = |place: &Rect| spots[0].is_place_ambiguous(place, &spots);
        let limits_and_occupied = ([0.0, 0.0, 150.0, 150.0], occupied.as_slice());
        let place = best_place(places(), limits_and_occupied, is_ambiguous).expect("there is room");
        assert!(!is_ambiguous(&place) && place[2] < 75.0 + 1.8, "{place:?}");
        let first = best_place(places(), limits_and_occupied, |_| false).expect("there is room");
        assert!(is_ambiguous(&first), "the first place is not nearer to the neighbour's whisker: {first:?}");
    }
}
