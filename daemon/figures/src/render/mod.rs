//! Renderers, which draw a layout on a page or in a file.
//!
//! [`page`] writes SVG for the dashboard: lengths in percent, text in the page's own size, classes instead of colours.
//! This SVG has no `style` attributes, because the content security policy forbids them. [`file`] writes an SVG file as
//! wide as a column of a paper, with lengths in points and literal attributes. [`export`] turns the SVG file into
//! pixels and PDF.

pub mod export;
pub mod file;
pub mod page;

use crate::look::Mark;
use crate::svg::append_number;

/// Returns the attribute `d` of a mark's outline around a point. The attribute is empty for a disc, which is drawn as a
/// circle.
fn outline(mark: Mark, (x, y): (f64, f64), radius: f64) -> String {
    let mut out = String::new();
    for (index, (right, down)) in mark.corners().iter().enumerate() {
        // A cross has two strokes, so it has a second start.
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
