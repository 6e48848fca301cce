//! A small line without axes, always shown with its number.

use std::fmt::Write as _;

use askama::Template;

/// A line over equally spaced moments on a fixed scale from 0 to 1.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/spark.html")]
pub(crate) struct Spark {
    label: String,
    area: String,
    line: String,
}

impl askama::filters::HtmlSafe for Spark {}

impl Spark {
    const HEIGHT: f64 = 20.0;

    /// Returns the line of `values`; a moment without a value parts it.
    pub(crate) fn new(label: String, values: &[Option<f64>]) -> Self {
        let step = 100.0 / values.len().saturating_sub(1).max(1) as f64;
        let (mut area, mut line) = (String::new(), String::new());
        let mut piece: Vec<(f64, f64)> = Vec::new();
        for (index, value) in values.iter().enumerate() {
            match value {
                Some(value) => {
                    piece.push((index as f64 * step, Self::HEIGHT * (1.0 - value.clamp(0.0, 1.0))));
                }
                None => Self::close(&mut piece, &mut area, &mut line),
            }
        }
        Self::close(&mut piece, &mut area, &mut line);
        Self { label, area, line }
    }

    fn close(piece: &mut Vec<(f64, f64)>, area: &mut String, line: &mut String) {
        let (Some(first), Some(last)) = (piece.first().copied(), piece.last().copied()) else { return };
        let mut path = String::new();
        for (index, (x, y)) in piece.drain(..).enumerate() {
            let _ = write!(path, "{}{x:.1} {y:.1}", if index == 0 { 'M' } else { 'L' });
        }
        let _ = write!(area, "{path}L{:.1} {h}L{:.1} {h}Z", last.0, first.0, h = Self::HEIGHT);
        line.push_str(&path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_parts_the_line() {
        let spark = Spark::new("CPU".into(), &[Some(0.0), Some(1.0), None, Some(0.5), Some(2.0)]);
        assert_eq!(spark.line, "M0.0 20.0L25.0 0.0M75.0 10.0L100.0 0.0");
        assert_eq!(spark.area.matches('Z').count(), 2);
    }

    #[test]
    fn no_values_no_line() {
        assert!(Spark::new("GPU".into(), &[None, None]).line.is_empty());
        assert!(Spark::new("GPU".into(), &[]).line.is_empty());
    }
}
