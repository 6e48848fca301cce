//! Many points on a sheet that is stretched over its plot: as dots, or counted into cells.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::pen::{self, At, SHEET};

/// Number of points from which on they are counted in cells, because dots would hide each other.
pub(super) const MANY: usize = 400;
/// Cells across and upright.
const CELLS: (u16, u16) = (50, 25);
/// Number of shades of cells.
const SHADES: u8 = 6;
/// Opacity of a cell with a single point, 0 to 1.
const FAINTEST: f64 = 0.18;

/// Points as paths.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Cloud {
    /// One for each point.
    pub(super) dots: Option<String>,
    /// Opacity and cells of it, the faintest first.
    pub(super) cells: Vec<(f64, String)>,
}

impl Cloud {
    /// Draws points of the sheet: one dot each if there are few, shaded cells otherwise.
    pub(super) fn of(points: &[At]) -> Self {
        if points.len() < MANY {
            let dots = (!points.is_empty()).then(|| pen::dots(points.iter().copied()));
            return Self { dots, cells: Vec::new() };
        }
        let mut counts = BTreeMap::<(u16, u16), u32>::new();
        for (x, y) in points {
            let place = |share: f64, cells: u16| ((share * f64::from(cells)) as u16).min(cells - 1);
            *counts.entry((place(*y, CELLS.1), place(*x, CELLS.0))).or_default() += 1;
        }
        let most = f64::from(counts.values().copied().max().unwrap_or(1)).ln_1p();
        // One point is seen, and ten times as many are a step darker, however many there are.
        let shade = |count: u32| (f64::from(count).ln_1p() / most * f64::from(SHADES)).ceil() as u8;
        let mut paths = BTreeMap::<u8, String>::new();
        let mut cells = counts.iter().map(|(place, count)| (*place, shade(*count))).peekable();
        while let Some(((row, column), shade)) = cells.next() {
            let mut end = column + 1;
            while cells.next_if_eq(&((row, end), shade)).is_some() {
                end += 1;
            }
            put(paths.entry(shade).or_default(), row, (column, end));
        }
        let opacity = |shade: u8| FAINTEST + (1.0 - FAINTEST) * f64::from(shade) / f64::from(SHADES);
        Self { dots: None, cells: paths.into_iter().map(|(shade, path)| (opacity(shade), path)).collect() }
    }
}

/// Neighbours in a row, as one.
fn put(path: &mut String, row: u16, (from, to): (u16, u16)) {
    let (width, height) = (SHEET / f64::from(CELLS.0), SHEET / f64::from(CELLS.1));
    let (x, y, long) = (f64::from(from) * width, f64::from(row) * height, f64::from(to - from) * width);
    let _ = write!(path, "M{x} {y}h{long}v{height}h-{long}z");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_points_are_dots_and_many_are_counted() {
        let points = |count: usize| (0..count).map(|n| (n as f64 / count as f64, 0.5)).collect::<Vec<At>>();
        let few = Cloud::of(&points(MANY - 1));
        assert_eq!(few.dots.as_deref().map(|path| path.matches('M').count()), Some(MANY - 1));
        assert!(few.cells.is_empty());
        assert_eq!(Cloud::of(&[]), Cloud::default());
        let many = Cloud::of(&points(MANY));
        assert_eq!((many.dots, many.cells), (None, vec![(1.0, "M0 480h1000v40h-1000z".to_owned())]));
    }

    #[test]
    fn the_fuller_a_cell_the_darker_it_is_and_a_single_point_is_seen() {
        let mut points = vec![(0.0, 0.0)];
        points.extend((0..10).map(|_| (0.5, 0.5)));
        points.extend((0..1_000).map(|_| (1.0, 1.0)));
        let cells = Cloud::of(&points).cells;
        let paths: Vec<&str> = cells.iter().map(|(_, path)| path.as_str()).collect();
        assert_eq!(paths, ["M0 0h20v40h-20z", "M500 480h20v40h-20z", "M980 960h20v40h-20z"]);
        assert!(cells[0].0 > FAINTEST && cells.windows(2).all(|pair| pair[0].0 < pair[1].0), "{cells:?}");
        assert!((cells[2].0 - 1.0).abs() < 1e-9, "{cells:?}");
    }
}
