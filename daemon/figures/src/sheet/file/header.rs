//! Caption and legend above the plots.

use super::draw::{line, point, rect, text};
use super::{EDGE, LINE, TEXT, WIDTH};
use crate::look::{INK, Mark, Style};
use crate::plot::{Anchor, Figure, Key, Swatch};
use crate::svg::Writer;
use crate::text::{shorten, width};

/// Room above the first line, points.
const ABOVE: f64 = 3.0;
/// Distance from the top of a line to its baseline, points.
const BASE: f64 = 7.5;
/// Width of a sample.
const SAMPLE: f64 = 13.5;
/// Width of the sample of a line with long dashes, which has a gap on each side of its mark.
const LONG: f64 = 22.0;
/// Distance from a sample to its words, and half of the distance to the next sample.
const GAP: f64 = 3.0;
/// Half the height of an area's sample.
const HALF: f64 = 3.0;
/// Radius of a mark's sample.
const RADIUS: f64 = 1.8;

fn sample_width(swatch: &Swatch) -> f64 {
    if matches!(swatch, Swatch::Curve(_, Mark::Diamond, _)) { LONG } else { SAMPLE }
}

/// Returns the positions of the entries: points from the left, and the number of the line.
fn places(legend: &[Key]) -> Vec<(f64, usize)> {
    let (mut x, mut line) = (EDGE, 0);
    let place = |key: &Key| {
        let wide = sample_width(&key.swatch) + GAP + width(&key.text, TEXT);
        if x > EDGE && x + wide > WIDTH - EDGE {
            (x, line) = (EDGE, line + 1);
        }
        let place = (x, line);
        x += wide + 2.0 * GAP;
        place
    };
    legend.iter().map(place).collect()
}

fn lines(legend: &[Key]) -> usize {
    places(legend).last().map_or(0, |(_, line)| line + 1)
}

/// Returns the height of the header above the first plot, points.
pub(super) fn height(figure: &Figure) -> f64 {
    let caption = usize::from(!figure.title.is_empty());
    ABOVE + LINE * (caption + lines(&figure.legend)) as f64 + 1.5
}

/// Returns the caption; without the number of values if both do not fit.
fn caption(figure: &Figure) -> String {
    let (room, whole) = (WIDTH - 2.0 * EDGE, figure.caption());
    if width(&whole, TEXT) <= room { whole } else { shorten(&figure.title, TEXT, room) }
}

pub(super) fn draw(svg: &mut Writer, figure: &Figure) {
    let mut top = ABOVE;
    if !figure.title.is_empty() {
        text(svg, &caption(figure), (EDGE, top + BASE), (TEXT, INK.light, Anchor::Start));
        top += LINE;
    }
    for (key, (x, line)) in figure.legend.iter().zip(places(&figure.legend)) {
        let top = top + LINE * line as f64;
        draw_sample(svg, &key.swatch, (x, top + LINE / 2.0));
        let from = x + sample_width(&key.swatch) + GAP;
        let words = shorten(&key.text, TEXT, WIDTH - from - EDGE / 2.0);
        text(svg, &words, (from, top + BASE), (TEXT, INK.light, Anchor::Start));
    }
}

fn draw_sample(svg: &mut Writer, swatch: &Swatch, (x, y): (f64, f64)) {
    let wide = sample_width(swatch);
    let (ends, middle) = ([(x, y), (x + wide, y)], (x + wide / 2.0, y));
    match swatch {
        Swatch::Area(style) => rect(svg, [(x, y - HALF), (x + wide, y + HALF)], style),
        Swatch::Line(style) => line(svg, ends, style),
        Swatch::Mark(mark, style) => point(svg, middle, (*mark, RADIUS), style),
        Swatch::Curve(course, mark, style) => {
            curve(svg, ends, course);
            point(svg, middle, (*mark, RADIUS), style);
        }
    }
}

/// Draws a line, or the area around a shape's mark.
fn curve(svg: &mut Writer, [from, to]: [(f64, f64); 2], style: &Style) {
    if style.fill.is_some() {
        rect(svg, [(from.0, from.1 - HALF), (to.0, to.1 + HALF)], style);
    } else {
        line(svg, [from, to], style);
    }
}
