//! A sample of points with the distributions of both quantities of all iterations, at the sides of the plot. Pages have it.

use peernet_statistics::Summary;

use super::binned::BinnedAxis;
use super::lengths::cells;
use crate::look::{Fill, Stage, Style};
use crate::plot::{At, Item, Path, Plot, Strip};

/// Number of points from which on they are counted in cells, because dots would hide each other.
const MANY: usize = 400;
/// Cells across and upwards.
const CELLS: (f64, f64) = (50.0, 25.0);
/// Points of a line that is drawn: on a logarithmic axis a straight line is a curve.
const STEPS: u32 = 64;

/// Values of a plot, as measured.
#[derive(Clone, Copy, Debug)]
pub struct Joint<'a> {
    /// Stage that determines the colour of the points.
    pub stage: Stage,
    /// A sample of the iterations.
    pub points: &'a [(f64, f64)],
    /// Axis and values of both quantities.
    pub x: (&'a BinnedAxis, &'a Summary),
    /// The same of the vertical axis.
    pub y: (&'a BinnedAxis, &'a Summary),
    /// Intercept and slope of a line through the points.
    pub line: Option<(f64, f64)>,
}

impl Joint<'_> {
    fn place(&self, (across, up): (f64, f64)) -> Option<(f64, f64)> {
        Some((self.x.0.at(across)?, 1.0 - self.y.0.at(up)?))
    }

    fn inside(&self) -> Vec<(f64, f64)> {
        self.points.iter().filter_map(|point| self.place(*point)).collect()
    }

    /// Returns whether the points are counted into cells.
    pub fn is_counted(&self) -> bool {
        self.inside().len() >= MANY
    }

    /// Lays it out.
    pub fn plot(&self) -> Plot {
        let (x, y) = (self.x.0, self.y.0);
        let mut plot = Plot::new(x.axis(), y.axis());
        let points = self.inside();
        if self.is_counted() {
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
            let across = steps.map(|step| x.scale.between(ends.0, ends.1, step));
            let line = Path::line(across.map(|across| self.place((across, intercept + slope * across))));
            let styles =
                [Style::halo(), Style::of_page("fit")].into_iter().skip(usize::from(!self.is_counted()));
            plot.items.extend(styles.map(|style| Item::path(line.clone(), style)));
        }
        let bars = Style::total().bin();
        let rail = |to: (f64, f64)| Item::line(At::new(0.0, 1.0), At::new(to.0, to.1), Style::rail());
        let strip = |mut items: Vec<Item>, end| {
            items.push(rail(end));
            Some(Strip { items, size: 0.0 })
        };
        plot.above = strip(x.upright(self.x.1, &bars), (1.0, 1.0));
        plot.beside = strip(y.lying(self.y.1, &bars), (0.0, 0.0));
        plot
    }
}
