//! Paths over time on a sheet of 1,000 by 1,000 that is stretched over its plot.

use std::fmt::Write as _;

/// Length of both sides of the sheet.
pub(crate) const SHEET: f64 = 1_000.0;

/// Position of a point, as shares of the sheet from the left and from above.
pub(crate) type At = (f64, f64);

fn put(path: &mut String, command: char, (x, y): At) {
    let _ = write!(path, "{command}{:.1} {:.1}", x * SHEET, y * SHEET);
}

/// Draws a line that is interrupted where a value is missing; a value between two missing ones becomes a dot.
pub(crate) fn line(points: impl IntoIterator<Item = Option<At>>) -> String {
    let (mut path, mut open, mut alone) = (String::new(), false, None);
    for point in points.into_iter().chain([None]) {
        match point {
            Some(at) => {
                put(&mut path, if open { 'L' } else { 'M' }, at);
                alone = (!open).then_some(at);
                open = true;
            }
            None => {
                if let Some(at) = alone.take() {
                    put(&mut path, 'L', at);
                }
                open = false;
            }
        }
    }
    path
}

/// Returns the area between two lines, in pieces where a value is missing.
pub(crate) fn band(points: impl IntoIterator<Item = Option<(f64, f64, f64)>>) -> String {
    let mut path = String::new();
    let mut piece: Vec<(f64, f64, f64)> = Vec::new();
    for point in points.into_iter().chain([None]) {
        match point {
            Some(point) => piece.push(point),
            None => {
                for (index, (x, upper, _)) in piece.iter().enumerate() {
                    put(&mut path, if index == 0 { 'M' } else { 'L' }, (*x, *upper));
                }
                for (x, _, lower) in piece.iter().rev() {
                    put(&mut path, 'L', (*x, *lower));
                }
                if !piece.is_empty() {
                    path.push('Z');
                }
                piece.clear();
            }
        }
    }
    path
}

/// Returns the area between a line and the lower end of the sheet, in pieces where a value is missing.
pub(crate) fn area(points: impl IntoIterator<Item = Option<At>>) -> String {
    let (mut path, mut last) = (String::new(), None);
    for point in points.into_iter().chain([None]) {
        match (point, last) {
            (Some(at), None) => {
                put(&mut path, 'M', (at.0, 1.0));
                put(&mut path, 'L', at);
            }
            (Some(at), Some(_)) => put(&mut path, 'L', at),
            (None, Some((x, _))) => {
                put(&mut path, 'L', (x, 1.0));
                path.push('Z');
            }
            (None, None) => {}
        }
        last = point;
    }
    path
}

/// Dots: lines of no length, drawn by their round ends.
pub(crate) fn dots(points: impl IntoIterator<Item = At>) -> String {
    let mut path = String::new();
    for at in points {
        put(&mut path, 'M', at);
        path.push_str("h0");
    }
    path
}

/// Returns upright error bars with caps of that share of the sheet to each side: left, upper end, lower end.
pub(crate) fn whiskers(points: impl IntoIterator<Item = (f64, f64, f64)>, cap: f64) -> String {
    let mut path = String::new();
    for (x, upper, lower) in points {
        put(&mut path, 'M', (x, upper));
        put(&mut path, 'L', (x, lower));
        for end in [upper, lower] {
            put(&mut path, 'M', (x - cap, end));
            put(&mut path, 'L', (x + cap, end));
        }
    }
    path
}

/// Returns upright ticks: left, upper end, lower end.
pub(crate) fn ticks(ticks: impl IntoIterator<Item = (f64, f64, f64)>) -> String {
    let mut path = String::new();
    for (x, upper, lower) in ticks {
        put(&mut path, 'M', (x, upper));
        put(&mut path, 'L', (x, lower));
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_parts_lines_and_bands() {
        let points = [Some((0.0, 0.0)), Some((0.1, 1.0)), None, Some((0.5, 0.5))];
        assert_eq!(line(points), "M0.0 0.0L100.0 1000.0M500.0 500.0L500.0 500.0");
        let band = band([Some((0.0, 0.1, 0.2)), Some((0.1, 0.1, 0.2)), None, Some((0.5, 0.1, 0.2))]);
        assert_eq!(band.matches('Z').count(), 2);
        assert!(band.starts_with("M0.0 100.0L100.0 100.0L100.0 200.0L0.0 200.0Z"), "{band}");
        assert_eq!(line([None, None]), "");
        let area = area([Some((0.0, 0.2)), Some((0.1, 0.3)), None, Some((0.5, 0.1)), Some((0.6, 0.1))]);
        assert!(area.starts_with("M0.0 1000.0L0.0 200.0L100.0 300.0L100.0 1000.0ZM500.0 1000.0"), "{area}");
        assert_eq!(area.matches('Z').count(), 2);
    }

    #[test]
    fn whisker_has_caps_and_dot_has_no_length() {
        assert_eq!(whiskers([(0.5, 0.2, 0.4)], 0.01).matches('M').count(), 3);
        assert_eq!(dots([(0.5, 0.5)]), "M500.0 500.0h0");
    }
}
