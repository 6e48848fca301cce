//! Points of several series with their names, error bars and lines through them. Pages have it.

mod names;

use crate::look::{Mark, Stage, Style};
use crate::plot::{At, Axis, Item, Key, Path, Plot, Swatch};
use names::{Named, labels};

/// Points of a line that is drawn: on a logarithmic axis a straight line is a curve.
const STEPS: u32 = 64;
/// Radius of a point, points.
const RADIUS: f64 = 3.75;

/// Figure of points. Values are in the units of the axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Scatter {
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Series, the lowest first.
    pub series: Vec<ScatterSeries>,
}

/// Points that share a look.
#[derive(Clone, Debug, PartialEq)]
pub struct ScatterSeries {
    /// Name in the legend.
    pub name: String,
    /// Stage that determines the colour.
    pub stage: Stage,
    /// Points of the series.
    pub points: Vec<ScatterPoint>,
    /// Straight lines through them.
    pub lines: Vec<ScatterLine>,
}

/// One point.
#[derive(Clone, Debug, PartialEq)]
pub struct ScatterPoint {
    /// Value across.
    pub x: f64,
    /// Value upwards.
    pub y: f64,
    /// Lower and upper end of its error bar.
    pub ends: Option<(f64, f64)>,
    /// Label beside the point; none if empty.
    pub name: String,
}

impl ScatterPoint {
    /// Returns the upper end of the point and its error bar.
    pub fn top(&self) -> f64 {
        self.ends.map_or(self.y, |(_, high)| high)
    }
}

/// A straight line between two values of x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScatterLine {
    /// Value at zero.
    pub intercept: f64,
    /// Growth with x.
    pub slope: f64,
    /// First value of x.
    pub from: f64,
    /// Last value of x.
    pub to: f64,
}

impl Scatter {
    /// Returns the entries of the legend.
    pub fn legend(&self) -> Vec<Key> {
        let key =
            |one: &ScatterSeries| Key::new(Swatch::Mark(Mark::Disc, one.stage.mark()), one.name.clone());
        self.series.iter().map(key).collect()
    }

    /// Lays the plot out: lines, points with their error bars, names.
    pub fn plot(&self) -> Plot {
        let mut plot = Plot::new(self.x.clone(), self.y.clone().with_grid());
        // Values beyond the end of the axis leave the plot.
        let place = |plot: &Plot, x: f64, y: f64| (plot.x.scale.at(x), 1.0 - plot.y.scale.at_or_outside(y));
        let mut drawn: Vec<(f64, f64)> = Vec::new();
        let mut points = Vec::new();
        let mut named = Vec::new();
        for one in &self.series {
            let look = one.stage;
            for line in &one.lines {
                let steps = (0..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
                let across = steps.map(|step| plot.x.scale.between(line.from, line.to, step));
                let course: Vec<_> =
                    across.map(|x| place(&plot, x, line.intercept + line.slope * x)).collect();
                drawn.extend(&course);
                let path = Path::line(course.into_iter().map(Some));
                plot.items.push(Item::path(path, look.line(0.75).with("fit")));
            }
            for (index, point) in one.points.iter().enumerate() {
                let (x, y) = place(&plot, point.x, point.y);
                if let Some((low, high)) = point.ends {
                    let [low, high] = [low, high].map(|value| place(&plot, point.x, value).1);
                    let step = |step: u32| low + (high - low) * f64::from(step) / f64::from(STEPS);
                    drawn.extend((0..=STEPS).map(|number| (x, step(number))));
                    points.push(Item::line(At::new(x, high), At::new(x, low), Style::of_page("whisk")));
                }
                points.push(Item::mark(At::new(x, y), Mark::Disc, RADIUS, look.mark().with("cut")));
                named.push(Named { at: (x, y), number: index, name: &point.name });
            }
        }
        plot.items.extend(points);
        plot.items.extend(labels(&named, &drawn).into_iter().map(Item::Text));
        plot
    }
}
