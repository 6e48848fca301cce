//! Figure of a quantity against the size of messages, on logarithmic axes. Each size has a point with a bar and a
//! whisker. A series can have a line.

use peernet_statistics::number::bytes;

use crate::look::{Mark, Style, stage};
use crate::plot::{At, Figure, Item, Key, Plot, Swatch, Unit};
use crate::scale::Scale;

/// Half the distance between the points of two series at the same size, points.
const HALF_DISTANCE: f64 = 2.0;
/// Width of a bar, points.
const BAR_WIDTH: f64 = 2.7;
/// Half the width of a whisker's cap, points.
const CAP_HALF_WIDTH: f64 = 1.7;
/// Approximate width of the plot in a file, points.
const PLOT_WIDTH: f64 = 220.0;
/// Radius of a point, points.
const RADIUS: f64 = 1.9;
/// Width of the line of a series, points.
const LINE_WIDTH: f64 = 0.75;
/// Width of the line of a whisker, points.
const WHISKER_WIDTH: f64 = 0.45;
/// Exponent that gives the room beyond the values at each end of the vertical axis. The room is a factor: the ratio of
/// the highest to the lowest value to this power.
const AXIS_MARGIN: f64 = 0.06;
/// Minimum of the factor that is the room beyond the values at each end of the vertical axis.
const MIN_ROOM: f64 = 1.15;
/// Room beyond the sizes at each end of the horizontal axis, as a factor.
const SIDE_FACTOR: f64 = 1.4;
/// Maximum factor between a horizontal line and the values. A line that is farther away would squeeze the values, so a
/// note replaces the line.
const MAX_LINE_RATIO: f64 = 20.0;

/// Statistics of the messages of one size, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Value {
    /// Size in bytes.
    pub bytes: f64,
    /// Value of the point.
    pub value: f64,
    /// The 5th and the 95th percentile, drawn as the ends of a bar; `None` if they are not known.
    pub p5_and_p95: Option<(f64, f64)>,
    /// Lower and upper bound of the true value, drawn as a whisker. A whisker without an upper bound leaves the plot.
    pub bounds: Option<(f64, Option<f64>)>,
}

/// Values of one direction at several sizes.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Stage that determines the colour: `upload` or `download`.
    pub stage: &'static str,
    /// Mark of the series.
    pub mark: Mark,
    /// Values, one for each size.
    pub values: Vec<Value>,
    /// Line of the series: intercept in SI units and slope in SI units per byte; `None` if no line is drawn.
    pub line: Option<(f64, f64)>,
}

impl Value {
    /// Returns the ends of the whisker; `None` if there are no bounds, or if the bounds are equal because one clock
    /// stamped both departure and arrival.
    fn whisker(&self) -> Option<(f64, Option<f64>)> {
        self.bounds.filter(|(lo, hi)| hi.is_none_or(|hi| hi > *lo))
    }
}

/// Explanations of the points, whiskers and lines of a figure, in a few words each. The figure shows the explanations
/// of what is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Explanations {
    /// Explanation of the points.
    pub point: &'static str,
    /// Explanation of the whiskers.
    pub whisker: &'static str,
    /// Explanation of the lines.
    pub line: &'static str,
}

/// Figure of a quantity against the size of messages.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaling {
    /// Title of the figure.
    pub title: String,
    /// Unit of the vertical axis.
    pub unit: Unit,
    /// Explanations of points, whiskers and lines. Bars need no explanation here, because they always show the 5th to
    /// the 95th percentile.
    pub explanations: Explanations,
    /// Further notes on the values.
    pub notes: Vec<String>,
    /// Series: at most two.
    pub series: Vec<Series>,
}

impl Scaling {
    fn values(&self) -> impl Iterator<Item = &Value> {
        self.series.iter().flat_map(|series| &series.values).filter(|value| value.value > 0.0)
    }

    /// Returns the lowest and the highest of all values, ends of bars and bounds, SI units. A bound
    /// or a 5th percentile that is far from its value is replaced by a nearer number.
    fn heights(&self) -> Option<(f64, f64)> {
        let extent = |value: &Value| {
            let (lo, hi) = value.p5_and_p95.unwrap_or((value.value, value.value));
            let whisker = value.whisker();
            // Bounds that are far from the value, such as a lower bound near zero, would squeeze everything else.
            let top = whisker.and_then(|bounds| bounds.1).map_or(hi, |bound| bound.min(value.value * 10.0));
            let bottom = whisker.map_or(lo, |bounds| bounds.0.max(value.value / 4.0));
            // A 5th percentile near zero would squeeze everything else, too. A logarithmic axis
            // cannot show numbers that are not above zero at all.
            (bottom.min(lo).max(value.value / 100.0), top.max(hi))
        };
        self.values().map(extent).reduce(|(lo, hi), (a, b)| (lo.min(a), hi.max(b)))
    }

    /// Returns the height of the horizontal line of a series, and whether the line is near enough to the values to be
    /// drawn. `None` if the series has no line, or if its line is not horizontal and above zero.
    fn horizontal_line(&self, series: &Series) -> Option<(f64, bool)> {
        let (height, _) = series.line.filter(|(height, slope)| *slope == 0.0 && *height > 0.0)?;
        let (low, high) = self.heights()?;
        Some((height, height <= high * MAX_LINE_RATIO && height >= low / MAX_LINE_RATIO))
    }

    /// Returns whether the line of a series is horizontal and too far from the values to be drawn.
    fn is_line_too_far(&self, series: &Series) -> bool {
        self.horizontal_line(series).is_some_and(|(_, is_near)| !is_near)
    }

    /// Returns notes on how to read the figure: the explanations of what is drawn, the names of lines that are not
    /// drawn, and the further notes.
    fn reading_notes(&self) -> Vec<String> {
        let mut explanations = vec![format!("point: {}", self.explanations.point)];
        if self.values().any(|value| value.p5_and_p95.is_some()) {
            explanations.push("bar: 5th to 95th percentile".to_owned());
        }
        if self.values().any(|value| value.whisker().is_some()) {
            explanations.push(format!("whisker: {}", self.explanations.whisker));
        }
        if self.series.iter().any(|series| series.line.is_some() && !self.is_line_too_far(series)) {
            explanations.push(format!("line: {}", self.explanations.line));
        }
        let mut notes = vec![explanations.join(" · ")];
        // The name of a series begins with its direction: `upload: 12 MB/s`.
        let far_lines: Vec<&str> = self
            .series
            .iter()
            .filter(|series| self.is_line_too_far(series))
            .map(|series| series.name.split(':').next().unwrap_or_default())
            .collect();
        if !far_lines.is_empty() {
            let names = far_lines.join(" and of ");
            notes.push(format!("far beyond the axis and not drawn: the line of {names}"));
        }
        notes.extend(self.notes.iter().cloned());
        notes
    }

    /// Returns an empty plot whose axes contain all values and horizontal lines; `None` if no value is above zero.
    fn empty_plot(&self) -> Option<Plot> {
        let sizes = self.values().map(|value| (value.bytes, value.bytes));
        let (small, large) = sizes.reduce(|(lo, hi), (a, b)| (lo.min(a), hi.max(b)))?;
        let heights = self
            .series
            .iter()
            .filter_map(|series| self.horizontal_line(series))
            .filter(|(_, is_near)| *is_near);
        let (low, high) =
            heights.fold(self.heights()?, |(lo, hi), (height, _)| (lo.min(height), hi.max(height)));
        let room = (high / low).powf(AXIS_MARGIN).max(MIN_ROOM);
        let y_scale = Scale::logarithmic((low * self.unit.per_si / room, high * self.unit.per_si * room));
        let x_scale = Scale::logarithmic((small / SIDE_FACTOR, large * SIDE_FACTOR));
        let x_axis = crate::plot::Axis::new(x_scale, "Size on the wire", "");
        Some(Plot::new(
            x_axis.labelled(|tick| bytes(tick.value).plain()),
            self.unit.axis(y_scale).with_grid(),
        ))
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let key = |series: &Series| {
            let (line, mark) = look(series);
            Key::new(Swatch::Curve(line, series.mark, mark), series.name.clone())
        };
        let plots = self.empty_plot().map(|mut plot| {
            // The offsets are symmetric, because twice the mean index is subtracted from twice the
            // index.
            let twice_mean_index = self.series.len() as f64 - 1.0;
            for (index, series) in self.series.iter().enumerate() {
                let dx = HALF_DISTANCE * (2.0 * index as f64 - twice_mean_index);
                let items = self.series_items(&plot, series, dx);
                plot.items.extend(items);
            }
            plot
        });
        Figure {
            title: self.title.clone(),
            legend: self.series.iter().map(key).collect(),
            notes: self.reading_notes(),
            plots: plots.into_iter().collect(),
            ..Figure::default()
        }
    }

    /// Returns the items of a series. The series is moved to the right by `dx` points, so that the points of two series
    /// at the same size are both visible.
    fn series_items(&self, plot: &Plot, series: &Series, dx: f64) -> Vec<Item> {
        let in_shown_unit = |value: f64| value * self.unit.per_si;
        let (line_style, mark_style) = look(series);
        let mut items = Vec::new();
        if let Some((intercept, slope)) = series.line.filter(|_| !self.is_line_too_far(series)) {
            let line = plot.curve(plot.x.scale.ends(), |bytes| in_shown_unit(intercept + slope * bytes));
            // A line that is not horizontal is moved by the same distance as the points, so that points that fit the
            // line lie on the line.
            let dx = if slope == 0.0 { 0.0 } else { dx };
            items.push(Item::path(line.within(dx / PLOT_WIDTH).offset_by(dx), line_style));
        }
        let colour = stage(series.stage).line_colour();
        let bar = Style::line(format!("g-{} bar", stage(series.stage).class), colour.tint(0.35), BAR_WIDTH);
        let whisker = Style::line("whisk2", colour, WHISKER_WIDTH);
        for value in series.values.iter().filter(|value| value.value > 0.0) {
            let at = |height: f64| plot.at(value.bytes, in_shown_unit(height)).offset_by(dx, 0.0);
            if let Some((lo, hi)) = value.p5_and_p95 {
                items.push(Item::line(at(lo), at(hi), bar.clone()));
            }
            if let Some((lo, hi)) = value.whisker() {
                let top = hi.map_or(At { y: 0.0, ..at(lo) }, at);
                // A whisker has no cap where it leaves the plot.
                let has_cap = [
                    plot.y.scale.has(in_shown_unit(lo)),
                    hi.is_some_and(|hi| plot.y.scale.has(in_shown_unit(hi))),
                ];
                items.extend(Item::whisker([at(lo), top], has_cap, CAP_HALF_WIDTH, &whisker));
            }
            items.push(Item::mark(at(value.value), series.mark, RADIUS, mark_style.clone()));
        }
        items
    }
}

/// Returns the style of the line and the style of the points.
fn look(series: &Series) -> (Style, Style) {
    let stage = stage(series.stage);
    (stage.line(LINE_WIDTH).dashed(series.mark.dash()).with("fit"), stage.mark())
}
