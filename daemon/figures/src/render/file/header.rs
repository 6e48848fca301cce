//! Caption and legend above the plots.

use super::draw::{line, point, rect, text};
use super::{EDGE, LINE, TEXT, WIDTH};
use crate::look::{INK, Mark, Style};
use crate::plot::{Anchor, Figure, Key, Swatch};
use crate::svg::Writer;
use crate::text::{shorten, width};

/// Room above the first line, points.
const TOP_MARGIN: f64 = 3.0;
/// Room below the last line, points.
const BOTTOM_MARGIN: f64 = 1.5;
/// Distance from the top of a line to its baseline, points.
const BASELINE: f64 = 7.5;
/// Width of a sample in the legend, points.
const SAMPLE_WIDTH: f64 = 13.5;
/// Width of the sample of a line with long dashes, points. This sample is wider, so that a gap between dashes is
/// visible on each side of the mark.
const LONG_SAMPLE_WIDTH: f64 = 22.0;
/// Distance from a sample in the legend to its text, points. The distance from the text to the next sample is twice as
/// long.
const GAP: f64 = 3.0;
/// Half the height of the sample of an area, points.
const HALF_HEIGHT: f64 = 3.0;
/// Radius of the sample of a mark, points.
const RADIUS: f64 = 1.8;

fn sample_width(swatch: &Swatch) -> f64 {
    // Only the line with diamonds has long dashes.
    if matches!(swatch, Swatch::Curve(_, Mark::Diamond, _)) { LONG_SAMPLE_WIDTH } else { SAMPLE_WIDTH }
}

/// Returns the position of each entry of the legend: its distance from the left in points, and the index of its line.
fn places(legend: &[Key]) -> Vec<(f64, usize)> {
    let (mut x, mut line) = (EDGE, 0);
    let place = |key: &Key| {
        let entry_width = sample_width(&key.swatch) + GAP + width(&key.text, TEXT);
        // An entry that is wider than the picture stays at the beginning of its line and is shortened.
        if x > EDGE && x + entry_width > WIDTH - EDGE {
            (x, line) = (EDGE, line + 1);
        }
        let place = (x, line);
        x += entry_width + 2.0 * GAP;
        place
    };
    legend.iter().map(place).collect()
}

/// Returns the number of lines that the legend needs.
fn line_count(legend: &[Key]) -> usize {
    places(legend).last().map_or(0, |(_, line)| line + 1)
}

/// Returns the height of the header above the first plot, points.
pub(super) fn height(figure: &Figure) -> f64 {
    let caption_lines = usize::from(!figure.title.is_empty());
    TOP_MARGIN + LINE * (caption_lines + line_count(&figure.legend)) as f64 + BOTTOM_MARGIN
}

/// Returns the caption: the title and the number of values. If the caption does not fit into a line, returns the title
/// without the number, shortened to a line.
fn caption(figure: &Figure) -> String {
    let (room, caption) = (WIDTH - 2.0 * EDGE, figure.caption());
    if width(&caption, TEXT) <= room { caption } else { shorten(&figure.title, TEXT, room) }
}

pub(super) fn draw(svg: &mut Writer, figure: &Figure) {
    let mut top = TOP_MARGIN;
    if !figure.title.is_empty() {
        text(svg, &caption(figure), (EDGE, top + BASELINE), (TEXT, INK.light, Anchor::Start));
        top += LINE;
    }
    for (key, (x, line)) in figure.legend.iter().zip(places(&figure.legend)) {
        let top = top + LINE * line as f64;
        draw_sample(svg, &key.swatch, (x, top + LINE / 2.0));
        let text_x = x + sample_width(&key.swatch) + GAP;
        let shortened = shorten(&key.text, TEXT, WIDTH - text_x - EDGE / 2.0);
        text(svg, &shortened, (text_x, top + BASELINE), (TEXT, INK.light, Anchor::Start));
    }
}

fn draw_sample(svg: &mut Writer, swatch: &Swatch, (x, y): (f64, f64)) {
    let width = sample_width(swatch);
    let (ends, middle) = ([(x, y), (x + width, y)], (x + width / 2.0, y));
    match swatch {
        Swatch::Area(style) => rect(svg, [(x, y - HALF_HEIGHT), (x + width, y + HALF_HEIGHT)], style),
        Swatch::Line(style) => line(svg, ends, style),
        Swatch::Mark(mark, style) => point(svg, middle, (*mark, RADIUS), style),
        Swatch::Curve(line_style, mark, mark_style) => {
            curve(svg, ends, line_style);
            point(svg, middle, (*mark, RADIUS), mark_style);
        }
    }
}

/// Draws a line, or an area if the style has a fill.
fn curve(svg: &mut Writer, [from, to]: [(f64, f64); 2], style: &Style) {
    if style.fill.is_some() {
        rect(svg, [(from.0, from.1 - HALF_HEIGHT), (to.0, to.1 + HALF_HEIGHT)], style);
    } else {
        line(svg, [from, to], style);
    }
}
