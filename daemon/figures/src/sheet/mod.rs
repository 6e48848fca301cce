//! Sheets: the two ways to draw a layout.
//!
//! [`page`] writes SVG for the dashboard: lengths in percent, text in the page's own size, classes instead of colours, and no style
//! attribute, which the content security policy forbids. [`file`] writes a picture of a column's width in points with literal
//! attributes; [`export`] turns it into pixels and PDF.

pub mod export;
pub mod file;
pub mod page;

use crate::look::Mark;
use crate::svg::number;

/// Returns the outline of a mark about a point; empty for a disc.
fn outline(mark: Mark, (x, y): (f64, f64), radius: f64) -> String {
    let mut out = String::new();
    for (index, (right, down)) in mark.corners().iter().enumerate() {
        let starts = index == 0 || (mark == Mark::Cross && index == 2);
        out.push(if starts { 'M' } else { 'L' });
        number(&mut out, x + right * radius, 2);
        out.push(' ');
        number(&mut out, y + down * radius, 2);
    }
    if !matches!(mark, Mark::Cross | Mark::Disc) {
        out.push('Z');
    }
    out
}
