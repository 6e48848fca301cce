//! Hatches, by which areas differ without colour.

/// Distance between two slanted lines of a hatch, points.
const SLANTED_DISTANCE: f64 = 3.9;
/// Distance between two horizontal or two vertical lines of a hatch, points.
const STRAIGHT_DISTANCE: f64 = SLANTED_DISTANCE / 1.5;
/// Minimum distance of a line from an edge of the area, points. A line that only touches a corner or runs along an edge
/// is left out.
const MIN_EDGE_DISTANCE: f64 = 0.2;

/// Lines over an area.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hatch {
    /// No hatch.
    Plain,
    /// `/`
    Rising,
    /// `\`
    Falling,
    /// `–`
    Horizontal,
    /// `|`
    Vertical,
    /// `×`
    Cross,
}

/// Ends of a line.
type Line = [(f64, f64); 2];

/// Returns the lines of a hatch over a rectangle, which is given by its left upper and its right lower corner. The
/// lines of all rectangles of a figure are on one grid.
pub(crate) fn lines([(left, top), (right, bottom)]: [(f64, f64); 2], hatch: Hatch) -> Vec<Line> {
    // Multiples of `step` between two edges. All areas use the same multiples, so that the lines of neighbouring areas
    // meet at their border.
    let multiples = |lo: f64, hi: f64, step: f64| {
        let first = ((lo + MIN_EDGE_DISTANCE) / step).ceil() as i64;
        (first..)
            .map(move |number| number as f64 * step)
            .take_while(move |position| *position < hi - MIN_EDGE_DISTANCE)
    };
    // On a rising line x + y is constant, on a falling line x − y is constant. From one line to the next, this sum or
    // difference grows by √2 times the distance between the lines.
    let slanted_step = SLANTED_DISTANCE * 1.4;
    let rising = || {
        multiples(left + top, right + bottom, slanted_step).map(|sum| {
            [(left.max(sum - bottom), bottom.min(sum - left)), (right.min(sum - top), top.max(sum - right))]
        })
    };
    let falling = || {
        multiples(left - bottom, right - top, slanted_step).map(|difference| {
            [
                (left.max(top + difference), top.max(left - difference)),
                (right.min(bottom + difference), bottom.min(right - difference)),
            ]
        })
    };
    match hatch {
        Hatch::Plain => Vec::new(),
        Hatch::Rising => rising().collect(),
        Hatch::Falling => falling().collect(),
        Hatch::Cross => rising().chain(falling()).collect(),
        Hatch::Horizontal => {
            multiples(top, bottom, STRAIGHT_DISTANCE).map(|y| [(left, y), (right, y)]).collect()
        }
        Hatch::Vertical => {
            multiples(left, right, STRAIGHT_DISTANCE).map(|x| [(x, top), (x, bottom)]).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hatch_lines_stay_inside_their_area() {
        let hatches = [Hatch::Rising, Hatch::Falling, Hatch::Horizontal, Hatch::Vertical, Hatch::Cross];
        let areas = [
            [(0.0, 0.0), (30.0, 9.0)],
            [(20.0, 116.0), (21.0, 165.0)],
            [(5.0, 5.0), (5.0, 5.0)],
            [(9.3, 9.1), (9.4, 60.0)],
        ];
        for (hatch, area) in hatches.into_iter().flat_map(|hatch| areas.map(|area| (hatch, area))) {
            let [(left, top), (right, bottom)] = area;
            let inside = |(x, y): &(f64, f64)| {
                (left - 1e-9..=right + 1e-9).contains(x) && (top - 1e-9..=bottom + 1e-9).contains(y)
            };
            let lines = lines(area, hatch);
            assert!(lines.iter().flatten().all(inside), "{hatch:?} {area:?} {lines:?}");
        }
        assert!(lines(areas[0], Hatch::Rising).len() > 4);
        assert!(lines(areas[0], Hatch::Plain).is_empty());
    }
}
