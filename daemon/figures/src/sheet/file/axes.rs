//! Axes of a plot.

use super::draw::{line, text};
use super::places::{Area, lines, row_size, rows};
use super::{EDGE, GAP, LINE, SMALL, TEXT, WIDTH};
use crate::look::{INK, INK_2, Style};
use crate::plot::{Anchor, Axis, Marks, Plot};
use crate::svg::Writer;
use crate::text::{shorten, shorten_distinctly, width};

/// Length of a mark below the horizontal axis, points.
const MARK: f64 = 1.8;
/// Distance from the horizontal axis to the baseline of its labels, points.
const LABEL: f64 = 9.5;
/// Distance from the middle of capital letters to their baseline, as a share of the type size.
const MIDDLE: f64 = 0.36;
/// Distance from the plot to the baseline of the title above it, points.
const TITLE: f64 = 5.5;

/// Draws the lines that go through the plot.
pub(super) fn draw_grid(svg: &mut Writer, plot: &Plot, area: &Area) {
    for tick in rows(plot, area.height).iter().filter(|_| plot.y.has_grid) {
        let y = area.bottom() - area.height * tick.at;
        line(svg, [(area.left, y), (area.right(), y)], &Style::grid());
    }
    for tick in plot.x.ticks(usize::MAX).iter().filter(|_| plot.x.has_grid) {
        let x = area.left + area.width * tick.at;
        line(svg, [(x, area.bottom()), (x, area.top)], &Style::grid());
    }
}

/// Draws labels, titles and the line below the plot.
pub(super) fn draw(svg: &mut Writer, plot: &Plot, area: &Area) {
    draw_rows(svg, plot, area);
    draw_columns(svg, plot, area);
    let strip = plot.above.as_ref().map_or(0.0, |strip| area.top - area.above(strip.size).top);
    let base = area.top - strip - plot.lines_above as f64 * (SMALL + 1.5) - TITLE;
    let remark = plot.remark.as_deref().unwrap_or_default();
    let end = area.right() + plot.beside.as_ref().map_or(0.0, |strip| strip.size + super::STRIP_GAP);
    if !remark.is_empty() {
        text(svg, remark, (end, base), (SMALL, INK_2.light, Anchor::End));
    }
    let room = WIDTH - 2.0 * EDGE - if remark.is_empty() { 0.0 } else { width(remark, SMALL) + 3.0 * GAP };
    text(svg, &shorten(&title(&plot.y, room), TEXT, room), (EDGE, base), (TEXT, INK_2.light, Anchor::Start));
}

/// Returns the title. If there is space, it has the information that the marks do not show.
fn title(axis: &Axis, room: f64) -> String {
    let full = axis.full_title();
    if width(&full, TEXT) > room && axis.scale.is_logarithmic() {
        format!("{} (log)", axis.title)
    } else {
        full
    }
}

fn draw_rows(svg: &mut Writer, plot: &Plot, area: &Area) {
    let (ticks, size) = (rows(plot, area.height), row_size(plot));
    let is_named = matches!(plot.y.marks, Marks::Names(_));
    let names: Vec<&str> = ticks.iter().map(|tick| tick.text.as_str()).collect();
    let room = area.left - EDGE - GAP;
    let names = if is_named {
        shorten_distinctly(&names, size, room + 0.1)
    } else {
        names.into_iter().map(str::to_owned).collect()
    };
    for (tick, name) in ticks.iter().zip(names) {
        let base = area.bottom() - area.height * tick.at + MIDDLE * size;
        if is_named {
            text(svg, &name, (EDGE, base), (size, INK.light, Anchor::Start));
        } else {
            text(svg, &name, (area.left - GAP, base), (size, INK_2.light, Anchor::End));
        }
    }
}

fn draw_columns(svg: &mut Writer, plot: &Plot, area: &Area) {
    let bottom = area.bottom();
    let ticks = plot.x.ticks(usize::MAX);
    let is_named = matches!(plot.x.marks, Marks::Names(_));
    line(svg, [(area.left, bottom), (area.right(), bottom)], &Style::rail());
    for tick in ticks.iter().filter(|_| !is_named) {
        let x = area.left + area.width * tick.at;
        line(svg, [(x, bottom), (x, bottom + MARK)], &Style::rail());
    }
    let mut taken = 0.0;
    for tick in ticks.iter().filter(|tick| !tick.text.is_empty()) {
        let half = tick.text.lines().map(|line| width(line, TEXT)).fold(0.0, f64::max) / 2.0;
        // A label at the end stays on the paper, and labels do not overlap.
        let x = (area.left + area.width * tick.at).min(WIDTH - 1.5 - half);
        if x - half < taken {
            continue;
        }
        taken = x + half + GAP;
        for (number, words) in tick.text.lines().enumerate() {
            let colour = if is_named { INK.light } else { INK_2.light };
            let base = bottom + LABEL + LINE * number as f64;
            text(svg, words, (x, base), (TEXT, colour, Anchor::Middle));
        }
    }
    if !plot.x.title.is_empty() {
        let labels = if ticks.is_empty() { 0 } else { lines(plot) };
        let base = bottom + LABEL + LINE * labels as f64;
        let middle = area.left + area.width / 2.0;
        text(svg, &plot.x.full_title(), (middle, base), (TEXT, INK_2.light, Anchor::Middle));
    }
}
