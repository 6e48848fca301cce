//! Places of the parts of a figure.

use super::{EDGE, GAP, HEIGHT, LINE, SMALL, STRIP_GAP, TEXT, WIDTH, header, table};
use crate::plot::{At, Figure, Height, Marks, Plot};
use crate::scale::Tick;
use crate::text::width;

/// Room above a plot for the title of its vertical axis, points.
const TITLE: f64 = 13.5;
/// Room below a plot without labels, points.
const BELOW: f64 = 3.0;
/// Distance between two plots, points.
const BETWEEN: f64 = 5.0;
/// Minimum distance of the marks of a vertical axis, so that their labels do not overlap, points.
const APART: f64 = 12.0;
/// Maximum width of names at a vertical axis, points.
pub const MOST_NAME: f64 = WIDTH * 0.47;
/// Names that are closer to each other than this have small type, points.
const CLOSE: f64 = 12.0;
/// Minimum height of a plot, points.
const LOWEST: f64 = 30.0;

/// Area of a plot, points from the left and from above.
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
    /// Returns the point of a place.
    pub fn point(&self, at: At) -> (f64, f64) {
        (self.left + self.width * at.x + at.dx, self.top + self.height * at.y + at.dy)
    }

    pub(super) fn right(&self) -> f64 {
        self.left + self.width
    }

    pub(super) fn bottom(&self) -> f64 {
        self.top + self.height
    }

    /// Returns the strip of the given height above.
    pub(super) fn above(&self, size: f64) -> Self {
        Self { top: self.top - STRIP_GAP - size, height: size, ..*self }
    }

    /// Returns the strip of the given width at the right.
    pub(super) fn beside(&self, size: f64) -> Self {
        Self { left: self.right() + STRIP_GAP, width: size, ..*self }
    }
}

/// Areas of all plots, and the height of the paper.
pub(super) struct Places {
    pub(super) height: f64,
    pub(super) plots: Vec<Area>,
}

/// Returns the areas of the plots of a figure, before anything is drawn in them, for kinds that search for free places.
pub fn areas(figure: &Figure) -> Vec<Area> {
    Places::of(figure).plots
}

impl Places {
    pub(super) fn of(figure: &Figure) -> Self {
        let top = header::height(figure);
        let around: f64 = figure.plots.iter().map(|plot| above(plot) + below(plot)).sum();
        let between = BETWEEN * figure.plots.len().saturating_sub(1) as f64;
        let fixed: f64 = figure.plots.iter().map(|plot| fixed(plot.height)).sum();
        let rest = figure.plots.iter().filter(|plot| plot.height == Height::Rest).count();
        // A figure has its standard height, plus the heights of plots with a fixed height if there are others.
        let content = if rest > 0 || figure.plots.is_empty() {
            let others: f64 = figure.plots.iter().filter(|plot| plot.height != Height::Rest).map(own).sum();
            HEIGHT + others
        } else {
            top + around + between + fixed
        };
        let free = (content - top - around - between - fixed) / rest.max(1) as f64;
        let widest = figure.plots.iter().map(gutter).fold(0.0, f64::max);
        let mut y = top;
        let mut plots = Vec::with_capacity(figure.plots.len());
        for plot in &figure.plots {
            y += above(plot);
            let height = match plot.height {
                Height::Rest => free.max(LOWEST),
                Height::Points(points) => points,
            };
            let beside = plot.beside.as_ref().map_or(0.0, |strip| strip.size + STRIP_GAP);
            let left = EDGE + widest;
            plots.push(Area { left, top: y, width: WIDTH - EDGE - 3.0 - left - beside - plot.free, height });
            y += height + below(plot) + BETWEEN;
        }
        Self { height: content + table::height(&figure.table), plots }
    }
}

fn fixed(height: Height) -> f64 {
    if let Height::Points(points) = height { points } else { 0.0 }
}

fn own(plot: &Plot) -> f64 {
    fixed(plot.height) + above(plot) + below(plot) + BETWEEN
}

fn above(plot: &Plot) -> f64 {
    let title = if plot.y.title.is_empty() && plot.remark.is_none() { 0.0 } else { TITLE };
    let strip = plot.above.as_ref().map_or(0.0, |strip| strip.size + STRIP_GAP);
    title + strip + plot.lines_above as f64 * (SMALL + 1.5)
}

/// Returns the height of labels and title of the horizontal axis.
fn below(plot: &Plot) -> f64 {
    let labels = if has_labels(plot) { LINE } else { 0.0 };
    let title = if plot.x.title.is_empty() { 0.0 } else { LINE };
    BELOW + labels * lines(plot) as f64 + title
}

/// Returns whether the horizontal axis has labels: of several plots only the lowest has them.
fn has_labels(plot: &Plot) -> bool {
    match &plot.x.marks {
        Marks::Round(_) => true,
        Marks::At(ticks) | Marks::Names(ticks) => ticks.iter().any(|tick| !tick.text.is_empty()),
    }
}

/// Returns the number of lines of the labels of the horizontal axis.
pub(super) fn lines(plot: &Plot) -> usize {
    match &plot.x.marks {
        Marks::Names(ticks) => ticks.iter().map(|tick| tick.text.lines().count()).max().unwrap_or(1),
        Marks::Round(_) | Marks::At(_) => 1,
    }
}

/// Returns the marks of the vertical axis of a plot of a height: a low one has fewer.
pub(super) fn rows(plot: &Plot, height: f64) -> Vec<Tick> {
    plot.y.ticks(((height / APART) as usize).clamp(1, 5))
}

/// Returns the type size of the labels of the vertical axis.
pub(super) fn row_size(plot: &Plot) -> f64 {
    let Marks::Names(ticks) = &plot.y.marks else { return TEXT };
    let is_close = matches!(plot.height, Height::Points(height) if height < ticks.len() as f64 * CLOSE);
    let is_long = ticks.iter().any(|tick| width(&tick.text, TEXT) > MOST_NAME);
    if is_close || is_long { SMALL } else { TEXT }
}

/// Returns the width of the labels of the vertical axis, with their distance from it.
fn gutter(plot: &Plot) -> f64 {
    let size = row_size(plot);
    let ticks = rows(plot, if let Height::Points(points) = plot.height { points } else { HEIGHT / 2.0 });
    let widest = ticks.iter().map(|tick| width(&tick.text, size)).fold(0.0, f64::max);
    let most = if matches!(plot.y.marks, Marks::Names(_)) { MOST_NAME } else { f64::INFINITY };
    if ticks.is_empty() { 0.0 } else { widest.min(most) + GAP }
}
