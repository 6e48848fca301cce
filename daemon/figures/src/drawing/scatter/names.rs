//! Names beside points.

use crate::look::TextStyle;
use crate::plot::{Anchor, At, Label};
use crate::text::rem;

/// Width and height of a narrow plot, rem. It is the worst case: a place that is free there is free in every plot.
const NARROW: (f64, f64) = (17.0, 14.0);
/// Height of a name, as a share of a narrow plot: less than the distance of a name above or below its point.
const HIGH: f64 = 0.06;
/// Width of a point, as a share of a narrow plot.
const POINT: f64 = 0.024;
/// Distance of a name from the middle of its point, as shares of a narrow plot.
const AWAY: (f64, f64) = (0.022, 0.065);
/// Largest number of names in one label; a table has all.
const MOST: usize = 2;
/// Place of a name: direction from its point, the end of the text that is near the point, and the shift from there in the type size. The
/// shift is the same in every plot, because a wide plot needs no more distance than a narrow one.
type NamePlace = ((f64, f64), Anchor, (f64, f64));
/// Places about a point, the best first.
const PLACES: [NamePlace; 8] = [
    ((1.0, 0.0), Anchor::Start, (0.7, 0.36)),
    ((-1.0, 0.0), Anchor::End, (-0.7, 0.36)),
    ((0.0, -1.0), Anchor::Middle, (0.0, -0.8)),
    ((0.0, 1.0), Anchor::Middle, (0.0, 1.5)),
    ((1.0, -1.0), Anchor::Start, (0.6, -0.8)),
    ((1.0, 1.0), Anchor::Start, (0.6, 1.5)),
    ((-1.0, -1.0), Anchor::End, (-0.6, -0.8)),
    ((-1.0, 1.0), Anchor::End, (-0.6, 1.5)),
];

/// Point that has a name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Named<'a> {
    /// Place in the plot, shares from the left and from above.
    pub(super) at: (f64, f64),
    /// Number in its series.
    pub(super) number: usize,
    /// The name; none if empty.
    pub(super) name: &'a str,
}

/// Names at a place.
#[derive(Clone, Debug, PartialEq)]
struct Placed<'a> {
    point: (f64, f64),
    /// Middle of the text in a narrow plot.
    middle: (f64, f64),
    anchor: Anchor,
    shift: (f64, f64),
    names: Vec<(usize, &'a str)>,
    /// The names in words, and their width as a share of a narrow plot.
    words: String,
    wide: f64,
}

impl<'a> Placed<'a> {
    fn new(of: &Named<'a>, ((across, down), anchor, shift): NamePlace) -> Self {
        let wide = wide(of.name);
        let middle = (of.at.0 + across * (AWAY.0 + wide / 2.0), of.at.1 + down * AWAY.1);
        let (names, words) = (vec![(of.number, of.name)], of.name.to_owned());
        Self { point: of.at, middle, anchor, shift, names, words, wide }
    }

    /// Adds the name of another point.
    fn join(&mut self, of: &Named<'a>) {
        self.names.push((of.number, of.name));
        self.words = listed(&self.names);
        self.wide = wide(&self.words);
    }

    /// Returns whether it overlaps something of this width and height about a place.
    fn overlaps(&self, (x, y): (f64, f64), (width, height): (f64, f64)) -> bool {
        (self.middle.0 - x).abs() < (self.wide + width) / 2.0
            && (self.middle.1 - y).abs() < (HIGH + height) / 2.0
    }

    fn label(&self) -> Label {
        let at = At::new(self.point.0, self.point.1);
        let label = Label::new(at, self.words.clone(), TextStyle::MARK).anchored(self.anchor);
        label.shifted(self.shift.0, self.shift.1)
    }
}

/// Returns the width of a text as a share of a narrow plot.
fn wide(words: &str) -> f64 {
    rem(words) / NARROW.0
}

/// Returns a name at each point that has room for it; a name that has none joins the nearest one. Names avoid the points of lines that are
/// `drawn`, where that is possible.
pub(super) fn labels(points: &[Named<'_>], drawn: &[(f64, f64)]) -> Vec<Label> {
    placed(points, drawn).iter().map(Placed::label).collect()
}

fn placed<'a>(points: &[Named<'a>], drawn: &[(f64, f64)]) -> Vec<Placed<'a>> {
    let mut all: Vec<Placed<'a>> = Vec::new();
    for point in points.iter().filter(|point| !point.name.is_empty()) {
        let is_free = |place: &Placed<'_>| {
            let on_points = points.iter().any(|other| place.overlaps(other.at, (POINT, HIGH)));
            let on_names = |other: &Placed<'_>| place.overlaps(other.middle, (other.wide, HIGH));
            !on_points && !all.iter().any(on_names)
        };
        let free: Vec<Placed<'a>> =
            PLACES.iter().map(|place| Placed::new(point, *place)).filter(is_free).collect();
        let is_clear = |place: &&Placed<'_>| !drawn.iter().any(|at| place.overlaps(*at, (0.0, 0.0)));
        let far = |place: &Placed<'_>| {
            (place.middle.0 - point.at.0).hypot((place.middle.1 - point.at.1) * NARROW.1 / NARROW.0)
        };
        if let Some(place) = free.iter().find(is_clear).or_else(|| free.first()) {
            all.push(place.clone());
        } else if let Some(nearest) = all.iter_mut().min_by(|a, b| far(a).total_cmp(&far(b))) {
            nearest.join(point);
        } else {
            all.push(Placed::new(point, PLACES[0]));
        }
    }
    all
}

/// Returns `local, cloud and 4 more`: in the order of their points, each name once.
fn listed(names: &[(usize, &str)]) -> String {
    let mut sorted = names.to_vec();
    sorted.sort_unstable();
    let mut names: Vec<&str> = Vec::new();
    for (_, name) in sorted {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let shown = names[..names.len().min(MOST)].join(", ");
    match names.len().saturating_sub(MOST) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 12] = ["A", "B", "C", "D", "E", "F", "G", "H", "I", "J", "K", "L"];

    fn named(points: &[(f64, f64)]) -> Vec<Named<'static>> {
        let named = points.iter().zip(NAMES).enumerate();
        named.map(|(number, (at, name))| Named { at: *at, number, name }).collect()
    }

    fn texts(points: &[(f64, f64)]) -> Vec<String> {
        labels(&named(points), &[]).into_iter().map(|label| label.words).collect()
    }

    #[test]
    fn names_do_not_lie_on_each_other() {
        let near: Vec<_> =
            (0..12).map(|at| (0.8 + f64::from(at) * 0.002, 0.5 - f64::from(at) * 0.005)).collect();
        let points = named(&near);
        let all = placed(&points, &[]);
        assert_eq!(all.iter().map(|place| place.names.len()).sum::<usize>(), 12, "{all:?}");
        let alone = all.iter().filter(|place| place.names.len() == 1);
        let size = |place: &Placed<'_>| (place.wide, HIGH);
        for (at, place) in alone.enumerate() {
            let before = all[..at].iter().filter(|other| other.names.len() == 1);
            assert!(before.into_iter().all(|other| !place.overlaps(other.middle, size(other))), "{all:?}");
        }
    }

    #[test]
    fn a_point_between_neighbours_at_its_height_has_its_own_name_above_or_below() {
        let level = [0.0, 0.5, 0.577, 0.607, 1.0].map(|x| (x, 0.5));
        assert_eq!(texts(&level), ["A", "B", "C", "D", "E"]);
    }

    #[test]
    fn no_line_runs_through_a_name_where_there_is_room_beside_it() {
        let points = named(&[0.1, 0.5, 0.9].map(|x| (x, 0.5)));
        let line: Vec<(f64, f64)> = (100..=900).map(|at| (f64::from(at) / 1e3, 0.5)).collect();
        let all = placed(&points, &line);
        assert_eq!(all.len(), 3, "{all:?}");
        assert!(all.iter().all(|place| line.iter().all(|at| !place.overlaps(*at, (0.0, 0.0)))), "{all:?}");
    }

    #[test]
    fn many_names_at_one_place_are_a_few_words() {
        let of = |places: &[usize]| listed(&places.iter().map(|at| (*at, NAMES[*at])).collect::<Vec<_>>());
        assert_eq!(of(&[4]), "E");
        assert_eq!(of(&[1, 0]), "A, B");
        assert_eq!(of(&[5, 0, 2, 3, 4]), "A, C and 3 more");
        assert_eq!(listed(&[(0, "lan"), (1, "lan")]), "lan");
    }
}
