//! Renderers: they draw a layout on a page and in a file.
//!
//! [`page`] writes SVG for the dashboard: lengths in percent, text in the page's own size, classes instead of colours. It writes no `style`
//! attributes, because the content security policy forbids them. [`file`] writes an SVG file as wide as a column of a paper, with lengths
//! in points and literal attributes. [`export`] turns this SVG into pixels and PDF.

pub mod export;
pub mod file;
pub mod page;

use crate::look::Mark;
use crate::svg::append_number;

/// Returns the attribute `d` of a mark's outline around a point. It is empty for a disc, which is drawn as a circle.
fn outline(mark: Mark, (x, y): (f64, f64), radius: f64) -> String {
    let mut out = String::new();
    for (index, (right, down)) in mark.corners().iter().enumerate() {
        let is_start = index == 0 || (mark == Mark::Cross && index == 2);
        out.push(if is_start { 'M' } else { 'L' });
        append_number(&mut out, x + right * radius, 2);
        out.push(' ');
        append_number(&mut out, y + down * radius, 2);
    }
    if !matches!(mark, Mark::Cross | Mark::Disc) {
        out.push('Z');
    }
    out
}
