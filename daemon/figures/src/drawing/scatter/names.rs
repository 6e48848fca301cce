//! Names beside points.

use crate::look::TextStyle;
use crate::plot::{Anchor, At, Label};
use crate::text::rem;

/// Width and height of a narrow plot, rem. A narrow plot is the worst case: a place that is free in it is free in every plot.
const NARROW: (f64, f64) = (17.0, 14.0);
/// Height of a name, as a share of a narrow plot. It is less than the distance of a name above or below its point.
const NAME_HEIGHT: f64 = 0.06;
/// Width of a point, as a share of a narrow plot.
const POINT_WIDTH: f64 = 0.024;
/// Horizontal and vertical distance of a name from the middle of its point, as shares of a narrow plot.
const DISTANCE: (f64, f64) = (0.022, 0.065);
/// Maximum number of names in one label. The table beside the plot has all names.
const MAX_NAMES: usize = 2;
/// Place of a name: the direction from its point, the part of the text that is near the point, and the shift from the point as multiples of
/// the type size. The shift is the same in every plot, because a wide plot needs no more distance than a narrow plot.
type NamePlace = ((f64, f64), Anchor, (f64, f64));
/// Places around a point, the best first.
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
pub(super) struct NamedPoint<'a> {
    /// Position in the plot, shares from the left and from the top.
    pub(super) at: (f64, f64),
    /// Index of the point in its series.
    pub(super) number: usize,
    /// Name; empty for a point without a name.
    pub(super) name: &'a str,
}

/// Label with one or several names at a place.
#[derive(Clone, Debug, PartialEq)]
struct PlacedLabel<'a> {
    /// Position of the point that the label is placed at.
    point: (f64, f64),
    /// Middle of the text in a narrow plot.
    middle: (f64, f64),
    anchor: Anchor,
    shift: (f64, f64),
    /// Index and name of each point that the label names.
    names: Vec<(usize, &'a str)>,
    /// Text of the label.
    words: String,
    /// Width of the text as a share of a narrow plot.
    width: f64,
}

impl<'a> PlacedLabel<'a> {
    fn new(point: &NamedPoint<'a>, ((across, down), anchor, shift): NamePlace) -> Self {
        let width = text_width(point.name);
        let middle = (point.at.0 + across * (DISTANCE.0 + width / 2.0), point.at.1 + down * DISTANCE.1);
        let (names, words) = (vec![(point.number, point.name)], point.name.to_owned());
        Self { point: point.at, middle, anchor, shift, names, words, width }
    }

    /// Adds the name of another point.
    fn add_name(&mut self, point: &NamedPoint<'a>) {
        self.names.push((point.number, point.name));
        self.words = join_names(&self.names);
        self.width = text_width(&self.words);
    }

    /// Returns whether the label overlaps an area of this width and height around a position.
    fn overlaps(&self, (x, y): (f64, f64), (width, height): (f64, f64)) -> bool {
        (self.middle.0 - x).abs() < (self.width + width) / 2.0
            && (self.middle.1 - y).abs() < (NAME_HEIGHT + height) / 2.0
    }

    fn label(&self) -> Label {
        let at = At::new(self.point.0, self.point.1);
        let label = Label::new(at, self.words.clone(), TextStyle::MARK).anchored(self.anchor);
        label.shifted(self.shift.0, self.shift.1)
    }
}

/// Returns the width of a text as a share of a narrow plot.
fn text_width(words: &str) -> f64 {
    rem(words) / NARROW.0
}

/// Returns the labels of the points. Each name is beside its point if there is room; otherwise it is added to the nearest label. Names avoid
/// `line_points`, the points of drawn lines, where that is possible.
pub(super) fn labels(points: &[NamedPoint<'_>], line_points: &[(f64, f64)]) -> Vec<Label> {
    place_labels(points, line_points).iter().map(PlacedLabel::label).collect()
}

fn place_labels<'a>(points: &[NamedPoint<'a>], line_points: &[(f64, f64)]) -> Vec<PlacedLabel<'a>> {
    let mut labels: Vec<PlacedLabel<'a>> = Vec::new();
    for point in points.iter().filter(|point| !point.name.is_empty()) {
        let is_free = |label: &PlacedLabel<'_>| {
            let on_points = points.iter().any(|other| label.overlaps(other.at, (POINT_WIDTH, NAME_HEIGHT)));
            let on_label = |other: &PlacedLabel<'_>| label.overlaps(other.middle, (other.width, NAME_HEIGHT));
            !on_points && !labels.iter().any(on_label)
        };
        let free: Vec<PlacedLabel<'a>> =
            PLACES.iter().map(|place| PlacedLabel::new(point, *place)).filter(is_free).collect();
        let avoids_lines =
            |label: &&PlacedLabel<'_>| !line_points.iter().any(|at| label.overlaps(*at, (0.0, 0.0)));
        let distance = |label: &PlacedLabel<'_>| {
            (label.middle.0 - point.at.0).hypot((label.middle.1 - point.at.1) * NARROW.1 / NARROW.0)
        };
        if let Some(label) = free.iter().find(avoids_lines).or_else(|| free.first()) {
            labels.push(label.clone());
        } else if let Some(nearest) = labels.iter_mut().min_by(|a, b| distance(a).total_cmp(&distance(b))) {
            nearest.add_name(point);
        } else {
            labels.push(PlacedLabel::new(point, PLACES[0]));
        }
    }
    labels
}

/// Returns the text of several names: `local, cloud and 4 more`. The names are in the order of their points, each once.
fn join_names(names: &[(usize, &str)]) -> String {
    let mut sorted = names.to_vec();
    sorted.sort_unstable();
    let mut names: Vec<&str> = Vec::new();
    for (_, name) in sorted {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let shown = names[..names.len().min(MAX_NAMES)].join(", ");
    match names.len().saturating_sub(MAX_NAMES) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 12] = ["A", "B", "C", "D", "E", "F", "G", "H", "I", "J", "K", "L"];

    fn named_points(points: &[(f64, f64)]) -> Vec<NamedPoint<'static>> {
        let with_names = points.iter().zip(NAMES).enumerate();
        with_names.map(|(number, (at, name))| NamedPoint { at: *at, number, name }).collect()
    }

    fn texts(points: &[(f64, f64)]) -> Vec<String> {
        labels(&named_points(points), &[]).into_iter().map(|label| label.words).collect()
    }

    #[test]
    fn names_do_not_lie_on_each_other() {
        let near: Vec<_> =
            (0..12).map(|at| (0.8 + f64::from(at) * 0.002, 0.5 - f64::from(at) * 0.005)).collect();
        let points = named_points(&near);
        let labels = place_labels(&points, &[]);
        assert_eq!(labels.iter().map(|label| label.names.len()).sum::<usize>(), 12, "{labels:?}");
        let single_names = labels.iter().filter(|label| label.names.len() == 1);
        let size = |label: &PlacedLabel<'_>| (label.width, NAME_HEIGHT);
        for (index, label) in single_names.enumerate() {
            let mut previous = labels[..index].iter().filter(|other| other.names.len() == 1);
            assert!(previous.all(|other| !label.overlaps(other.middle, size(other))), "{labels:?}");
        }
    }

    #[test]
    fn point_between_level_neighbours_has_its_own_label() {
        let level = [0.0, 0.5, 0.577, 0.607, 1.0].map(|x| (x, 0.5));
        assert_eq!(texts(&level), ["A", "B", "C", "D", "E"]);
    }

    #[test]
    fn names_avoid_lines_where_there_is_room() {
        let points = named_points(&[0.1, 0.5, 0.9].map(|x| (x, 0.5)));
        let line: Vec<(f64, f64)> = (100..=900).map(|at| (f64::from(at) / 1e3, 0.5)).collect();
        let labels = place_labels(&points, &line);
        assert_eq!(labels.len(), 3, "{labels:?}");
        let crosses_line = |label: &PlacedLabel<'_>| line.iter().any(|at| label.overlaps(*at, (0.0, 0.0)));
        assert!(!labels.iter().any(crosses_line), "{labels:?}");
    }

    #[test]
    fn label_with_many_names_is_short() {
        let joined = |indexes: &[usize]| {
            join_names(&indexes.iter().map(|index| (*index, NAMES[*index])).collect::<Vec<_>>())
        };
        assert_eq!(joined(&[4]), "E");
        assert_eq!(joined(&[1, 0]), "A, B");
        assert_eq!(joined(&[5, 0, 2, 3, 4]), "A, C and 3 more");
        assert_eq!(join_names(&[(0, "lan"), (1, "lan")]), "lan");
    }
}
