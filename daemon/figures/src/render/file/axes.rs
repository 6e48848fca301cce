//! Draws the axes of a plot in a file.

use super::draw::{line, text};
use super::places::{Area, x_label_lines, y_label_size, y_ticks};
use super::{EDGE, GAP, LINE, SMALL, SMALL_LINE, STRIP_GAP, TEXT, WIDTH};
use crate::look::{INK, INK_2, Style};
use crate::plot::{Anchor, Axis, Marks, Plot};
use crate::svg::Writer;
use crate::text::{shorten, shorten_distinctly, width};

/// Length of a mark below the horizontal axis, points.
const MARK_LENGTH: f64 = 1.8;
/// Distance from the horizontal axis to the baseline of its labels, points.
const LABEL_DISTANCE: f64 = 9.5;
/// Distance from the middle of capital letters to their baseline, as a share of the type size.
const MIDDLE: f64 = 0.36;
/// Minimum distance from a label of the horizontal axis to the right edge of the picture, points.
const RIGHT_MARGIN: f64 = 1.5;
/// Distance from the plot to the baseline of the title above it, points.
const TITLE_DISTANCE: f64 = 5.5;

/// Draws the grid lines of both axes.
pub(super) fn draw_grid(svg: &mut Writer, plot: &Plot, area: &Area) {
    for tick in y_ticks(plot, area.height).iter().filter(|_| plot.y.has_grid) {
        let y = area.bottom() - area.height * tick.at;
        line(svg, [(area.left, y), (area.right(), y)], &Style::grid());
    }
    for tick in plot.x.ticks(usize::MAX).iter().filter(|_| plot.x.has_grid) {
        let x = area.left + area.width * tick.at;
        line(svg, [(x, area.bottom()), (x, area.top)], &Style::grid());
    }
}

/// Draws the labels and titles of both axes, the remark, and the horizontal axis line.
pub(super) fn draw(svg: &mut Writer, plot: &Plot, area: &Area) {
    draw_y_labels(svg, plot, area);
    draw_x_axis(svg, plot, area);
    let strip_height = plot.top_strip.as_ref().map_or(0.0, |strip| area.top - area.top_strip(strip.size).top);
    let baseline = area.top - strip_height - plot.lines_above as f64 * SMALL_LINE - TITLE_DISTANCE;
    let remark = plot.remark.as_deref().unwrap_or_default();
    let right = area.right() + plot.right_strip.as_ref().map_or(0.0, |strip| strip.size + STRIP_GAP);
    if !remark.is_empty() {
        text(svg, remark, (right, baseline), (SMALL, INK_2.light, Anchor::End));
    }
    // Title and remark share a line, so the title is shortened to the room that the remark leaves.
    let room = WIDTH - 2.0 * EDGE - if remark.is_empty() { 0.0 } else { width(remark, SMALL) + 3.0 * GAP };
    let title = shorten(&y_title(&plot.y, room), TEXT, room);
    text(svg, &title, (EDGE, baseline), (TEXT, INK_2.light, Anchor::Start));
}

/// Returns the full title of the vertical axis. If the full title is too wide, `(log scale)` is shortened to `(log)`.
fn y_title(axis: &Axis, room: f64) -> String {
    let full = axis.full_title();
    if width(&full, TEXT) > room && axis.scale.is_logarithmic() {
        format!("{} (log)", axis.title)
    } else {
        full
    }
}

fn draw_y_labels(svg: &mut Writer, plot: &Plot, area: &Area) {
    let (ticks, size) = (y_ticks(plot, area.height), y_label_size(plot));
    let has_names = matches!(plot.y.marks, Marks::Names(_));
    let labels: Vec<&str> = ticks.iter().map(|tick| tick.text.as_str()).collect();
    let room = area.left - EDGE - GAP;
    let labels = if has_names {
        // The widest name is as wide as the room. The tolerance keeps this name whole in spite of rounding.
        shorten_distinctly(&labels, size, room + 0.1)
    } else {
        labels.into_iter().map(str::to_owned).collect()
    };
    for (tick, label) in ticks.iter().zip(labels) {
        let baseline = area.bottom() - area.height * tick.at + MIDDLE * size;
        if has_names {
            text(svg, &label, (EDGE, baseline), (size, INK.light, Anchor::Start));
        } else {
            text(svg, &label, (area.left - GAP, baseline), (size, INK_2.light, Anchor::End));
        }
    }
}

/// Draws the horizontal axis: its line, marks, labels and title.
fn draw_x_axis(svg: &mut Writer, plot: &Plot, area: &Area) {
    let bottom = area.bottom();
    let ticks = plot.x.ticks(usize::MAX);
    let has_names = matches!(plot.x.marks, Marks::Names(_));
    line(svg, [(area.left, bottom), (area.right(), bottom)], &Style::rail());
    for tick in ticks.iter().filter(|_| !has_names) {
        let x = area.left + area.width * tick.at;
        line(svg, [(x, bottom), (x, bottom + MARK_LENGTH)], &Style::rail());
    }
    let mut end_of_labels = 0.0;
    for tick in ticks.iter().filter(|tick| !tick.text.is_empty()) {
        let half_width = tick.text.lines().map(|line| width(line, TEXT)).fold(0.0, f64::max) / 2.0;
        // A label at the right end is moved so that it stays in the picture. A label that would overlap the previous
        // label is left out.
        let x = (area.left + area.width * tick.at).min(WIDTH - RIGHT_MARGIN - half_width);
        if x - half_width < end_of_labels {
            continue;
        }
        end_of_labels = x + half_width + GAP;
        for (index, words) in tick.text.lines().enumerate() {
            let colour = if has_names { INK.light } else { INK_2.light };
            let baseline = bottom + LABEL_DISTANCE + LINE * index as f64;
            text(svg, words, (x, baseline), (TEXT, colour, Anchor::Middle));
        }
    }
    if !plot.x.title.is_empty() {
        let label_lines = if ticks.is_empty() { 0 } else { x_label_lines(plot) };
        let baseline = bottom + LABEL_DISTANCE + LINE * label_lines as f64;
        // A wide title is moved so that it stays in the picture, and shortened if it is wider than the picture.
        let title = shorten(&plot.x.full_title(), TEXT, WIDTH - 2.0 * EDGE);
        let half_width = width(&title, TEXT) / 2.0;
        let middle = area.left + area.width / 2.0;
        let middle = middle.min(WIDTH - EDGE - half_width).max(EDGE + half_width);
        text(svg, &title, (middle, baseline), (TEXT, INK_2.light, Anchor::Middle));
    }
}
