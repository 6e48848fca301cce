//! Figure of two quantities of each iteration against each other, such as response length and latency, with their distributions at the sides.

use std::collections::BTreeMap;

use peernet_statistics::number::fixed;

use super::histogram::{Bins, range};
use crate::look::{Fill, INK, Rgb, Stage, Style, stage};
use crate::plot::{At, Axis, Figure, Item, Path, Plot, Strip, Unit};
use crate::scale::Scale;
use peernet_analysis::order::SortedValues;

/// Maximum number of points that are drawn as dots. More points are counted into cells.
const MAX_POINTS: usize = 1500;
/// Number of cells across and upwards. A cell is about 1.8 points wide and high in a file.
const CELLS: (f64, f64) = (108.0, 60.0);
/// Number of shades of cells.
const SHADES: f64 = 14.0;
/// Width of a distribution at the side of the plot, points.
const SIDE_WIDTH: f64 = 26.0;
/// Minimum width and height of a bar, points.
const MIN_BAR_SIZE: f64 = 0.45;
/// Diameter of a point, points.
const POINT_DIAMETER: f64 = 2.4;
/// Share of the largest value: an axis begins at zero unless the smallest value is above it.
const ZERO_THRESHOLD: f64 = 0.75;
/// Space on both sides of values that are far from zero, as a share of their range.
const AXIS_MARGIN: f64 = 0.05;

/// Points with both marginal histograms.
#[derive(Clone, Debug, PartialEq)]
pub struct Lengths {
    /// Title of the figure.
    pub title: String,
    /// Unit of the horizontal axis.
    pub x: Unit,
    /// Unit of the vertical axis.
    pub y: Unit,
    /// Quantity of the vertical axis, which determines the colour of the points. A quantity that is not a stage is drawn in ink.
    pub stage: String,
    /// One point for each iteration, SI units; points that are not finite are left out.
    pub points: Vec<(f64, f64)>,
    /// Notes below the figure, such as the number of points and what is left out.
    pub notes: Vec<String>,
}

impl Lengths {
    fn sorted_coordinates(&self, coordinate: fn(&(f64, f64)) -> f64) -> SortedValues {
        let finite = self.points.iter().filter(|(x, y)| x.is_finite() && y.is_finite());
        finite.map(coordinate).collect()
    }

    /// Returns the positions of the points within the axes, as shares from the left and from the top.
    fn positions_in<'a>(&'a self, plot: &'a Plot) -> impl Iterator<Item = (f64, f64)> + 'a {
        let in_shown_units = |(x, y): &(f64, f64)| (x * self.x.per_si, y * self.y.per_si);
        let inside = self
            .points
            .iter()
            .map(in_shown_units)
            .filter(|(x, y)| plot.x.scale.has(*x) && plot.y.scale.has(*y));
        inside.map(|(x, y)| (plot.x.scale.at(x), plot.y_share(y)))
    }

    fn colour(&self) -> Rgb {
        coloured_stage(&self.stage).map_or(INK.light, |stage| stage.line_colour())
    }

    fn class(&self) -> &'static str {
        coloured_stage(&self.stage).map_or("ink", |stage| stage.class)
    }

    fn points(&self, plot: &Plot) -> Vec<Item> {
        let (colour, class) = (self.colour(), self.class());
        if self.points.len() <= MAX_POINTS {
            let style = Style::line(format!("dots d-{class}"), colour.tint(0.62), POINT_DIAMETER);
            return vec![Item::path(Path::dots(self.positions_in(plot)), style)];
        }
        let style = Style::area(format!("f-{class}"), Fill::of(colour));
        let shades = cells(self.positions_in(plot), CELLS).into_iter();
        shades.map(|(shade, path)| Item::path(path, style.clone().opacity(shade))).collect()
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let (xs, ys) = (self.sorted_coordinates(|(x, _)| *x), self.sorted_coordinates(|(_, y)| *y));
        let plot = range(&xs).zip(range(&ys)).map(|(across, up)| {
            let (x, y) = (axis(&self.x, across), axis(&self.y, up));
            let mut plot = Plot::new(x.with_grid(), y.with_grid());
            plot.items = self.points(&plot);
            let beyond = self.points.len() - self.positions_in(&plot).count();
            plot.remark = (beyond > 0).then(|| format!("{} beyond the axes", fixed(beyond as f64, 0)));
            let x_share = |value: f64| plot.x.scale.at(value * self.x.per_si);
            let y_share = |value: f64| plot.y_share(value * self.y.per_si);
            let top_strip = side_bars(&xs, |from, to, height| {
                [At::new(x_share(from), 1.0 - height), At::new(x_share(to), 1.0)]
            });
            let right_strip =
                side_bars(&ys, |from, to, width| [At::new(0.0, y_share(from)), At::new(width, y_share(to))]);
            (plot.top_strip, plot.right_strip) = (Some(top_strip), Some(right_strip));
            plot
        });
        let (title, notes) = (self.title.clone(), self.notes.clone());
        Figure { title, notes, plots: plot.into_iter().collect(), ..Figure::default() }
    }
}

/// Returns the stage with this name; `None` if the name is not that of a stage with its own colour.
fn coloured_stage(name: &str) -> Option<Stage> {
    Some(stage(name)).filter(Stage::has_colour)
}

/// Counts points into this number of cells across and upwards. Returns a path of rectangles for each shade from 0 to 1, the lightest shade
/// first. The shade grows with the logarithm of the count, so that a single point is visible.
pub(super) fn cells(
    points: impl Iterator<Item = (f64, f64)>,
    (columns, rows): (f64, f64),
) -> Vec<(f64, Path)> {
    let mut counts: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for (x, y) in points {
        let cell = ((x * columns).min(columns - 1.0) as u32, (y * rows).min(rows - 1.0) as u32);
        *counts.entry(cell).or_default() += 1;
    }
    let max_logarithm = f64::from(counts.values().copied().max().unwrap_or(1)).ln_1p();
    let mut cells_by_step: BTreeMap<u32, Vec<[(f64, f64); 2]>> = BTreeMap::new();
    for ((column, row), count) in counts {
        let step = (f64::from(count).ln_1p() / max_logarithm * SHADES).round() as u32;
        let corner = |column: u32, row: u32| (f64::from(column) / columns, f64::from(row) / rows);
        cells_by_step.entry(step).or_default().push([corner(column, row), corner(column + 1, row + 1)]);
    }
    let shade = |step: u32| 0.18 + 0.82 * f64::from(step) / SHADES;
    cells_by_step.into_iter().map(|(step, cells)| (shade(step), Path::rects(cells))).collect()
}

/// Returns bars of the values along one axis. `corners` returns two corners of a bar for the two ends of a bin and its height.
fn side_bars(values: &SortedValues, corners: impl Fn(f64, f64, f64) -> [At; 2]) -> Strip {
    let style = Style::total().bin();
    let bar = |bins: &Bins, number: usize| {
        let (from, to) = bins.bin(number);
        let height = bins.counts[number] as f64 / bins.highest().max(1) as f64;
        let [from, to] = corners(from, to, height);
        Item::Rect { from, to, least: (MIN_BAR_SIZE, MIN_BAR_SIZE), style: style.clone() }
    };
    let bars = |bins: Bins| -> Vec<Item> {
        let filled = (0..bins.counts.len()).filter(|number| bins.counts[*number] > 0);
        filled.map(|number| bar(&bins, number)).collect()
    };
    Strip { items: Bins::of(values).map(bars).unwrap_or_default(), size: SIDE_WIDTH }
}

/// Returns whether an axis from zero would squeeze all values between these into a corner.
pub(super) fn would_squeeze(lo: f64, hi: f64) -> bool {
    hi > lo && lo > hi * ZERO_THRESHOLD
}

fn axis(unit: &Unit, (lo, hi): (f64, f64)) -> Axis {
    let (lo, hi) = (lo * unit.per_si, hi * unit.per_si);
    let room = (hi - lo) * AXIS_MARGIN;
    unit.axis(if would_squeeze(lo, hi) {
        Scale::linear((lo - room, hi + room))
    } else {
        Scale::from_zero((lo, hi))
    })
}
