//! Plot of points for some iterations, with the distribution of each quantity over all iterations at a side of the
//! plot.

use std::collections::BTreeMap;

use peernet_statistics::{Moments, Summary};

use super::binned::BinnedAxis;
use crate::look::{Fill, INK, Stage, Style};
use crate::plot::{At, Item, Path, Plot, Strip};

/// With at least this number of points, shaded cells replace the points, because the points would hide each other.
const MIN_POINTS_FOR_CELLS: usize = 400;
/// Numbers of columns and rows of cells. A cell is about 4 points wide and high in a file.
const CELLS: (f64, f64) = (50.0, 25.0);
/// Number of shades of cells.
const SHADES: f64 = 14.0;
/// Diameter of a point in a file, points.
const POINT_DIAMETER: f64 = 2.4;
/// Width of a distribution at the side of the plot in a file, points.
const SIDE_WIDTH: f64 = 26.0;
/// Width of the line through the points in a file, points.
const LINE_WIDTH: f64 = 0.75;

/// Plot of two quantities against each other. All values are in SI units.
#[derive(Clone, Copy, Debug)]
pub struct Joint<'a> {
    /// Stage that determines the colour of the points.
    pub stage: Stage,
    /// Points for some or all of the iterations.
    pub points: &'a [(f64, f64)],
    /// Horizontal axis, and the distribution of its quantity over all iterations.
    pub x: (&'a BinnedAxis, &'a Summary),
    /// Vertical axis, and the distribution of its quantity over all iterations.
    pub y: (&'a BinnedAxis, &'a Summary),
    /// Intercept and slope of the line through the points, in SI units; `None` if no line is drawn.
    pub line: Option<(f64, f64)>,
}

impl Joint<'_> {
    /// Returns the position of a point, as shares from the left and from the top; `None` for a point beyond the end of
    /// an axis.
    fn position(&self, (x, y): (f64, f64)) -> Option<(f64, f64)> {
        Some((self.x.0.at(x)?, 1.0 - self.y.0.at(y)?))
    }

    /// Returns the positions of the points that are not beyond the end of an axis.
    pub(super) fn positions(&self) -> Vec<(f64, f64)> {
        self.points.iter().filter_map(|point| self.position(*point)).collect()
    }

    /// Returns whether shaded cells replace the points. The shade of a cell shows how many points lie in the cell.
    pub fn has_cells(&self) -> bool {
        self.positions().len() >= MIN_POINTS_FOR_CELLS
    }

    /// Lays the plot out.
    pub fn plot(&self) -> Plot {
        let (x, y) = (self.x.0, self.y.0);
        let mut plot = Plot::new(x.axis(), y.axis());
        let points = self.positions();
        if self.has_cells() {
            let style = Style::area(format!("f-{}", self.stage.class), Fill::of(self.stage.line_colour()));
            let cells = cells_by_shade(points.into_iter(), CELLS).into_iter();
            plot.items.extend(cells.map(|(shade, path)| Item::path(path, style.clone().opacity(shade))));
        } else if !points.is_empty() {
            let colour = self.stage.line_colour().tint(0.62);
            // A dot is a line of length zero, so the width of this line is the diameter of the dot.
            let style = Style::line(format!("dots d-{}", self.stage.class), colour, POINT_DIAMETER);
            plot.items.push(Item::path(Path::dots(points), style));
        }
        if let Some((intercept, slope)) = self.line {
            let Moments { min, max, .. } = self.x.1.moments;
            let [x_per_si, y_per_si] = [x.unit.per_si, y.unit.per_si];
            let (start, end) = x.range();
            let ends = (min.max(start) * x_per_si, max.min(end) * x_per_si);
            let line = plot.curve(ends, |x| (intercept + slope * x / x_per_si) * y_per_si);
            // Over cells, the line needs a halo. Without cells, the halo is skipped.
            let styles = [Style::halo(), Style::line("fit", INK.light, LINE_WIDTH)];
            let needed_styles = styles.into_iter().skip(usize::from(!self.has_cells()));
            plot.items.extend(needed_styles.map(|style| Item::path(line.clone(), style)));
        }
        let bar_style = Style::total().bin();
        // Each strip has a line along the side that is next to the plot.
        let strip = |mut items: Vec<Item>, line_end: At| {
            items.push(Item::line(At::new(0.0, 1.0), line_end, Style::rail()));
            Some(Strip { items, size: SIDE_WIDTH })
        };
        plot.top_strip = strip(x.upright_bars(self.x.1, &bar_style), At::new(1.0, 1.0));
        plot.right_strip = strip(y.horizontal_bars(self.y.1, &bar_style), At::new(0.0, 0.0));
        plot
    }
}

/// Divides the plot into `columns` × `rows` cells and counts the points in each cell. Returns the shades, the lightest
/// first, each with a path of the cells that have this shade. A shade is an opacity from 0 to 1. The shade grows with
/// the logarithm of the count, so that a cell with a single point is visible.
fn cells_by_shade(points: impl Iterator<Item = (f64, f64)>, (columns, rows): (f64, f64)) -> Vec<(f64, Path)> {
    let mut counts: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for (x, y) in points {
        let cell = ((x * columns).min(columns - 1.0) as u32, (y * rows).min(rows - 1.0) as u32);
        *counts.entry(cell).or_default() += 1;
    }
    let max_logarithm = f64::from(counts.values().copied().max().unwrap_or(1)).ln_1p();
    let mut cells_by_level: BTreeMap<u32, Vec<[(f64, f64); 2]>> = BTreeMap::new();
    for ((column, row), count) in counts {
        let level = (f64::from(count).ln_1p() / max_logarithm * SHADES).round() as u32;
        let corner = |column: u32, row: u32| (f64::from(column) / columns, f64::from(row) / rows);
        cells_by_level.entry(level).or_default().push([corner(column, row), corner(column + 1, row + 1)]);
    }
    // Even the lightest shade is opaque enough to be visible.
    let shade = |level: u32| 0.18 + 0.82 * f64::from(level) / SHADES;
    cells_by_level.into_iter().map(|(level, cells)| (shade(level), Path::rects(cells))).collect()
}
