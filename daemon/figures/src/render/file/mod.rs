//! SVG for files: a picture as wide as a column of a paper, with lengths in points and literal attributes.
//!
//! The picture has a caption of one line, the legend, the plots from top to bottom, and a table that explains the
//! numbers beside points. All other text is in the caption's file ([`Figure::caption_text`]).

mod axes;
mod draw;
mod header;
mod places;
mod table;
#[cfg(test)]
mod tests;

pub use places::{Area, MAX_NAME_WIDTH, areas};

use crate::look::{INK_2, WHITE};
use crate::plot::{Anchor, Figure};
use crate::svg::{Tag, Writer};
use crate::text::FAMILY;

/// Width of a column, points: 3.5 inches.
pub const WIDTH: f64 = 252.0;
/// Standard height of a figure, points.
pub const HEIGHT: f64 = 189.0;
/// Type size of captions, legends and axes, points.
pub const TEXT: f64 = 7.5;
/// Type size of all other text, points. No text is smaller.
pub const SMALL: f64 = 7.0;

/// Distance of texts and axes from the edge of the picture, points.
const EDGE: f64 = 5.0;
/// Distance between an axis and its labels, points.
const GAP: f64 = 2.7;
/// Distance between two lines of text, points.
const LINE: f64 = 10.0;
/// Distance between two lines of labels above a plot, points.
const SMALL_LINE: f64 = SMALL + 1.5;
/// Distance between a plot and the [strip](crate::plot::Strip) along its side, points.
const STRIP_GAP: f64 = 2.0;
/// Number of points in an inch.
const POINTS_PER_INCH: f64 = 72.0;

/// Draws a figure.
pub fn svg(figure: &Figure) -> String {
    let places = places::Places::of(figure);
    let mut svg = Writer::default();
    let (width, height) = (WIDTH, places.height);
    let inches = |points: f64| format!("{}in", points / POINTS_PER_INCH);
    let root = svg.element(Tag::Svg).set("xmlns", "http://www.w3.org/2000/svg");
    let root = root.set("width", inches(width)).set("height", inches(height));
    let root = root.set("viewBox", format!("0 0 {width} {height}"));
    // A program that does not have the font uses one of the substitutes. Their letters are at most as wide as those of
    // the font, so text does not overlap.
    root.set("font-family", format!("{FAMILY}, Helvetica, Arial, sans-serif")).open();
    svg.element(Tag::Rect).set("width", width).set("height", height).set("fill", WHITE).leaf();
    header::draw(&mut svg, figure);
    for (plot, area) in figure.plots.iter().zip(&places.plots) {
        axes::draw_grid(&mut svg, plot, area);
        draw::items(&mut svg, &plot.items, area);
        axes::draw(&mut svg, plot, area);
        if let Some(strip) = &plot.top_strip {
            draw::items(&mut svg, &strip.items, &area.top_strip(strip.size));
        }
        if let Some(strip) = &plot.right_strip {
            draw::items(&mut svg, &strip.items, &area.right_strip(strip.size));
        }
    }
    if figure.plots.is_empty() {
        let middle = (width / 2.0, (header::height(figure) + height) / 2.0);
        draw::text(&mut svg, "no values", middle, (TEXT, INK_2.light, Anchor::Middle));
    }
    table::draw(&mut svg, &figure.table, height - table::height(&figure.table));
    svg.finish()
}
