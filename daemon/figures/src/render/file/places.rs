//! Areas of the plots of a figure in its picture.

use super::{EDGE, GAP, HEIGHT, LINE, SMALL, SMALL_LINE, STRIP_GAP, TEXT, WIDTH, header, table};
use crate::plot::{At, Figure, Height, Marks, Plot};
use crate::scale::Tick;
use crate::text::width;

/// Room above a plot for the title of its vertical axis, points.
const TITLE_HEIGHT: f64 = 13.5;
/// Room below a plot in addition to the room for labels and title, points.
const MARGIN_BELOW: f64 = 3.0;
/// Room at the right of a plot and its strip in addition to the distance from the edge of the picture, points.
const MARGIN_RIGHT: f64 = 3.0;
/// Distance between two plots, points.
const PLOT_DISTANCE: f64 = 5.0;
/// Minimum distance of the marks of a vertical axis, so that their labels do not overlap, points.
const MIN_MARK_DISTANCE: f64 = 12.0;
/// Maximum width of names at a vertical axis, points.
pub const MAX_NAME_WIDTH: f64 = WIDTH * 0.47;
/// Names at a vertical axis have small type if their distance is less than this, points.
const MIN_NAME_DISTANCE: f64 = 12.0;
/// Minimum height of a plot of flexible height, points.
const MIN_HEIGHT: f64 = 30.0;

/// Area of a plot, points from the left and from the top of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    /// Left end.
    pub left: f64,
    /// Upper end.
    pub top: f64,
    /// Width.
    pub width: f64,
    /// Height.
    pub height: f64,
}

impl Area {
    /// Returns the coordinates of a place in the plot, points.
    pub fn point(&self, at: At) -> (f64, f64) {
        (self.left + self.width * at.x + at.dx, self.top + self.height * at.y + at.dy)
    }

    pub(super) fn right(&self) -> f64 {
        self.left + self.width
    }

    pub(super) fn bottom(&self) -> f64 {
        self.top + self.height
    }

    /// Returns the strip of this height above the area.
    pub(super) fn top_strip(&self, size: f64) -> Self {
        Self { top: self.top - STRIP_GAP - size, height: size, ..*self }
    }

    /// Returns the strip of this width at the right of the area.
    pub(super) fn right_strip(&self, size: f64) -> Self {
        Self { left: self.right() + STRIP_GAP, width: size, ..*self }
    }
}

/// Areas of all plots, and the height of the picture.
pub(super) struct Places {
    /// Height of the picture, points.
    pub(super) height: f64,
    /// Areas of the plots, from top to bottom.
    pub(super) plots: Vec<Area>,
}

/// Returns the areas of the plots of a figure. A kind of figure that searches for free places in a plot needs the areas
/// before it adds the items.
pub fn areas(figure: &Figure) -> Vec<Area> {
    Places::of(figure).plots
}

impl Places {
    pub(super) fn of(figure: &Figure) -> Self {
        let top = header::height(figure);
        // Height of the titles, labels and strips of all plots.
        let surroundings: f64 = figure.plots.iter().map(|plot| height_above(plot) + height_below(plot)).sum();
        let distances = PLOT_DISTANCE * figure.plots.len().saturating_sub(1) as f64;
        let fixed_heights: f64 = figure.plots.iter().map(|plot| fixed_height(plot.height)).sum();
        let flexible_count = figure.plots.iter().filter(|plot| plot.height == Height::Flexible).count();
        // A figure with a flexible plot has the standard height, plus the heights of its plots with a fixed height. A
        // figure whose plots all have a fixed height is as high as these plots need.
        let content_height = if flexible_count > 0 || figure.plots.is_empty() {
            let fixed_plots = figure.plots.iter().filter(|plot| plot.height != Height::Flexible);
            HEIGHT + fixed_plots.map(height_with_surroundings).sum::<f64>()
        } else {
            top + surroundings + distances + fixed_heights
        };
        let flexible_height =
            (content_height - top - surroundings - distances - fixed_heights) / flexible_count.max(1) as f64;
        let y_labels_width = figure.plots.iter().map(y_labels_width).fold(0.0, f64::max);
        let mut y = top;
        let mut plots = Vec::with_capacity(figure.plots.len());
        for plot in &figure.plots {
            y += height_above(plot);
            let height = match plot.height {
                Height::Flexible => flexible_height.max(MIN_HEIGHT),
                Height::Points(points) => points,
            };
            let strip_width = plot.right_strip.as_ref().map_or(0.0, |strip| strip.size + STRIP_GAP);
            let left = EDGE + y_labels_width;
            let width = WIDTH - EDGE - MARGIN_RIGHT - left - strip_width - plot.free_right;
            plots.push(Area { left, top: y, width, height });
            y += height + height_below(plot) + PLOT_DISTANCE;
        }
        Self { height: content_height + table::height(&figure.table), plots }
    }
}

/// Returns the height of a plot with a fixed height, and 0 for other plots.
fn fixed_height(height: Height) -> f64 {
    if let Height::Points(points) = height { points } else { 0.0 }
}

fn height_with_surroundings(plot: &Plot) -> f64 {
    fixed_height(plot.height) + height_above(plot) + height_below(plot) + PLOT_DISTANCE
}

/// Returns the height of the title, the strip and the lines of text above a plot.
fn height_above(plot: &Plot) -> f64 {
    // The remark stands in the same line as the title.
    let title = if plot.y.title.is_empty() && plot.remark.is_none() { 0.0 } else { TITLE_HEIGHT };
    let strip = plot.top_strip.as_ref().map_or(0.0, |strip| strip.size + STRIP_GAP);
    title + strip + plot.lines_above as f64 * SMALL_LINE
}

/// Returns the height of the labels and the title of the horizontal axis, below a plot.
fn height_below(plot: &Plot) -> f64 {
    let label_height = if has_x_labels(plot) { LINE } else { 0.0 };
    let title_height = if plot.x.title.is_empty() { 0.0 } else { LINE };
    MARGIN_BELOW + label_height * x_label_lines(plot) as f64 + title_height
}

/// Returns whether the horizontal axis has labels. If several plots share a horizontal axis, only the lowest plot has
/// labels.
fn has_x_labels(plot: &Plot) -> bool {
    match &plot.x.marks {
        Marks::Round(_) => true,
        Marks::At(ticks) | Marks::Names(ticks) => ticks.iter().any(|tick| !tick.text.is_empty()),
    }
}

/// Returns the number of lines of the labels of the horizontal axis.
pub(super) fn x_label_lines(plot: &Plot) -> usize {
    match &plot.x.marks {
        Marks::Names(ticks) => ticks.iter().map(|tick| tick.text.lines().count()).max().unwrap_or(1),
        Marks::Round(_) | Marks::At(_) => 1,
    }
}

/// Returns the marks of the vertical axis of a plot with this height in points. A plot of less height has fewer round
/// marks.
pub(super) fn y_ticks(plot: &Plot, height: f64) -> Vec<Tick> {
    plot.y.ticks(((height / MIN_MARK_DISTANCE) as usize).clamp(1, 5))
}

/// Returns the type size of the labels of the vertical axis.
pub(super) fn y_label_size(plot: &Plot) -> f64 {
    let Marks::Names(ticks) = &plot.y.marks else { return TEXT };
    let is_close =
        matches!(plot.height, Height::Points(height) if height < ticks.len() as f64 * MIN_NAME_DISTANCE);
    let is_long = ticks.iter().any(|tick| width(&tick.text, TEXT) > MAX_NAME_WIDTH);
    if is_close || is_long { SMALL } else { TEXT }
}

/// Returns the width of the labels of the vertical axis, including their distance from the axis.
fn y_labels_width(plot: &Plot) -> f64 {
    let size = y_label_size(plot);
    // The height of a flexible plot is not known yet, so half of the standard height of a figure is assumed.
    let ticks = y_ticks(plot, if let Height::Points(points) = plot.height { points } else { HEIGHT / 2.0 });
    let widest = ticks.iter().map(|tick| width(&tick.text, size)).fold(0.0, f64::max);
    let max_width = if matches!(plot.y.marks, Marks::Names(_)) { MAX_NAME_WIDTH } else { f64::INFINITY };
    if ticks.is_empty() { 0.0 } else { widest.min(max_width) + GAP }
}
