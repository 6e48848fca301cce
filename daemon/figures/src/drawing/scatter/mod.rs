//! Points of several series with their names and error bars, and lines through the points. This plot is drawn only on web pages, not in files.

mod names;

use crate::look::{Mark, Stage, Style};
use crate::plot::{At, Axis, Item, Key, Plot, Swatch};
use names::{NamedPoint, labels};

/// Number of pieces of an error bar that names avoid.
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
    /// Series. Each is drawn over those before it.
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
    /// Straight lines through the points.
    pub lines: Vec<ScatterLine>,
}

/// One point.
#[derive(Clone, Debug, PartialEq)]
pub struct ScatterPoint {
    /// Value across.
    pub x: f64,
    /// Value upwards.
    pub y: f64,
    /// Lower and upper end of the point's error bar.
    pub ends: Option<(f64, f64)>,
    /// Label beside the point; a point with an empty name has none.
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
        let key = |series: &ScatterSeries| {
            Key::new(Swatch::Mark(Mark::Disc, series.stage.mark()), series.name.clone())
        };
        self.series.iter().map(key).collect()
    }

    /// Lays the plot out: lines, points with their error bars, names.
    pub fn plot(&self) -> Plot {
        let mut plot = Plot::new(self.x.clone(), self.y.clone().with_grid());
        // Values beyond the end of the axis leave the plot.
        let position =
            |plot: &Plot, x: f64, y: f64| (plot.x.scale.at(x), 1.0 - plot.y.scale.at_or_outside(y));
        // Points of the drawn lines and error bars, which names should avoid.
        let mut line_points: Vec<(f64, f64)> = Vec::new();
        let mut point_items = Vec::new();
        let mut named_points = Vec::new();
        for series in &self.series {
            let look = series.stage;
            for line in &series.lines {
                let path = plot.curve((line.from, line.to), |x| line.intercept + line.slope * x);
                line_points.extend(path.points());
                plot.items.push(Item::path(path, look.line(0.75).with("fit")));
            }
            for (index, point) in series.points.iter().enumerate() {
                let (x, y) = position(&plot, point.x, point.y);
                if let Some((low, high)) = point.ends {
                    let [low, high] = [low, high].map(|value| position(&plot, point.x, value).1);
                    let y_at = |step: u32| low + (high - low) * f64::from(step) / f64::from(STEPS);
                    line_points.extend((0..=STEPS).map(|step| (x, y_at(step))));
                    point_items.push(Item::line(At::new(x, high), At::new(x, low), Style::of_page("whisk")));
                }
                point_items.push(Item::mark(At::new(x, y), Mark::Disc, RADIUS, look.mark().with("cut")));
                named_points.push(NamedPoint { at: (x, y), number: index, name: &point.name });
            }
        }
        plot.items.extend(point_items);
        plot.items.extend(labels(&named_points, &line_points).into_iter().map(Item::Text));
        plot
    }
}
