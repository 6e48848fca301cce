//! A sample of points, with the distributions of both quantities over all iterations at the sides of the plot. Only pages have this kind.

use peernet_statistics::Summary;

use super::binned::BinnedAxis;
use super::lengths::cells;
use crate::look::{Fill, Stage, Style};
use crate::plot::{At, Item, Path, Plot, Strip};

/// Number of points from which on cells with shades replace the points, because dots would hide each other.
const MIN_POINTS_FOR_CELLS: usize = 400;
/// Number of cells across and upwards.
const CELLS: (f64, f64) = (50.0, 25.0);
/// Number of pieces of a drawn line, because a straight line is a curve on a logarithmic axis.
const STEPS: u32 = 64;

/// Values of a plot, in SI units.
#[derive(Clone, Copy, Debug)]
pub struct Joint<'a> {
    /// Stage that determines the colour of the points.
    pub stage: Stage,
    /// A sample of the iterations.
    pub points: &'a [(f64, f64)],
    /// Horizontal axis, and the distribution of its quantity over all iterations.
    pub x: (&'a BinnedAxis, &'a Summary),
    /// Vertical axis, and the distribution of its quantity over all iterations.
    pub y: (&'a BinnedAxis, &'a Summary),
    /// Intercept and slope of a line through the points.
    pub line: Option<(f64, f64)>,
}

impl Joint<'_> {
    /// Returns the position of a point, as shares from the left and from the top; `None` beyond the end of an axis.
    fn position(&self, (x, y): (f64, f64)) -> Option<(f64, f64)> {
        Some((self.x.0.at(x)?, 1.0 - self.y.0.at(y)?))
    }

    /// Returns the positions of the points that are not beyond the end of an axis.
    fn positions(&self) -> Vec<(f64, f64)> {
        self.points.iter().filter_map(|point| self.position(*point)).collect()
    }

    /// Returns whether the points are counted into cells, whose shades show the counts.
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
            let shades = cells(points.into_iter(), CELLS).into_iter();
            plot.items.extend(shades.map(|(shade, path)| Item::path(path, style.clone().opacity(shade))));
        } else if !points.is_empty() {
            let style = Style::of_page(format!("dots d-{}", self.stage.class));
            plot.items.push(Item::path(Path::dots(points), style));
        }
        if let Some((intercept, slope)) = self.line {
            let ends = (self.x.1.moments.min, self.x.1.moments.max.min(x.end()));
            let steps = (0..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
            let xs = steps.map(|step| x.scale.between(ends.0, ends.1, step));
            let line = Path::line(xs.map(|x| self.position((x, intercept + slope * x))));
            // The line needs a halo only over cells.
            let styles =
                [Style::halo(), Style::of_page("fit")].into_iter().skip(usize::from(!self.has_cells()));
            plot.items.extend(styles.map(|style| Item::path(line.clone(), style)));
        }
        let bars = Style::total().bin();
        // Each strip has a line along the side that is next to the plot.
        let strip = |mut items: Vec<Item>, line_end: At| {
            items.push(Item::line(At::new(0.0, 1.0), line_end, Style::rail()));
            Some(Strip { items, size: 0.0 })
        };
        plot.top_strip = strip(x.upright_bars(self.x.1, &bars), At::new(1.0, 1.0));
        plot.right_strip = strip(y.level_bars(self.y.1, &bars), At::new(0.0, 0.0));
        plot
    }
}
