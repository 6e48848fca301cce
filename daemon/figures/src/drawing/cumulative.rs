//! Figure of cumulative distributions: each quantity has a curve, which shows the share of iterations up to each value.

use peernet_statistics::number::count;

use super::histogram::{beyond_remark, shown_range_of};
use crate::look::{Mark, Style};
use crate::plot::{Axis, Figure, Item, Key, Path, Plot, Swatch, Unit};
use crate::scale::{Scale, ZERO_THRESHOLD, is_wide};
use peernet_analysis::order::SortedValues;

/// Maximum number of points of a curve.
const CURVE_POINTS: usize = 240;
/// Exponent that gives the room beyond the values at each end of a logarithmic axis. The ratio of the
/// largest to the smallest value is raised to this power. The axis begins at the smallest value divided
/// by the result, and ends at the largest value multiplied by the result.
const AXIS_MARGIN_EXPONENT: f64 = 0.02;
/// Height at which the first curve has its mark, as a share of the plot.
const FIRST_MARK_HEIGHT: f64 = 0.12;
/// Difference between the heights at which two consecutive curves have their marks, so that no mark hides another.
const MARK_DISTANCE: f64 = 0.16;
/// Radius of a mark, points.
const RADIUS: f64 = 1.7;

/// Cumulative distributions.
#[derive(Clone, Debug, PartialEq)]
pub struct Cumulative {
    /// Title.
    pub title: String,
    /// Quantity and unit of the horizontal axis.
    pub unit: Unit,
    /// Curves in the order of the legend.
    pub curves: Vec<CumulativeCurve>,
    /// Notes below the figure, such as the number of values and what is left out.
    pub notes: Vec<String>,
}

/// Curve of one quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct CumulativeCurve {
    /// Name of the quantity.
    pub name: String,
    /// Style of the line.
    pub line: Style,
    /// Shape and style of the mark.
    pub mark: (Mark, Style),
    /// The values, SI units.
    pub values: SortedValues,
}

impl CumulativeCurve {
    /// Returns the number of values below and the number of values above the ends of an axis. The axis has `per_si` times
    /// the values.
    fn count_beyond(&self, (from, to): (f64, f64), per_si: f64) -> (u64, u64) {
        let shown = || self.values.values().iter().map(|value| value * per_si);
        (
            shown().filter(|value| *value < from).count() as u64,
            shown().filter(|value| *value > to).count() as u64,
        )
    }
}

impl Cumulative {
    /// Returns the curves that are drawn, each with the range of its values without far tails.
    fn shown_curves(&self) -> impl Iterator<Item = (&CumulativeCurve, (f64, f64))> {
        let curves_with_values =
            self.curves.iter().filter_map(|curve| Some((curve, shown_range_of(&curve.values)?)));
        curves_with_values.filter(|(_, (lo, hi))| lo.is_finite() && hi.is_finite())
    }

    fn scale(&self) -> Option<Scale> {
        let ends = self.shown_curves().map(|(_, ends)| ends);
        let (lo, hi) = ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        let medians: SortedValues =
            self.shown_curves().filter_map(|(curve, _)| curve.values.median()).collect();
        let (smallest, largest) = medians.values().first().zip(medians.values().last())?;
        let (lo, hi) = (lo * self.unit.per_si, hi * self.unit.per_si);
        Some(if lo > 0.0 && is_wide((*smallest, *largest)) {
            let room = (hi / lo).powf(AXIS_MARGIN_EXPONENT);
            Scale::logarithmic((lo / room, hi * room))
        } else if lo > hi * ZERO_THRESHOLD {
            Scale::linear((lo, hi))
        } else {
            Scale::from_zero((lo, hi))
        })
    }

    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let mut notes = self.notes.clone();
        let mut plots = Vec::new();
        if let Some(scale) = self.scale() {
            let y_axis = Axis::new(Scale::linear((0.0, 100.0)), "Share of iterations, %", "%");
            let mut plot = Plot::new(self.unit.axis(scale).with_grid(), y_axis.with_grid());
            for (index, (curve, _)) in self.shown_curves().enumerate() {
                plot.items.extend(self.curve_items(&plot, index, curve));
            }
            let (per_si, (from, to)) = (self.unit.per_si, scale.ends());
            let counts: Vec<(&str, (u64, u64))> = self
                .shown_curves()
                .map(|(curve, _)| (curve.name.as_str(), curve.count_beyond((from, to), per_si)))
                .filter(|(_, beyond)| *beyond != (0, 0))
                .collect();
            if let [(_, beyond)] = counts.as_slice()
                && self.curves.len() == 1
            {
                plot.remark = beyond_remark(*beyond, (from / per_si, to / per_si), &self.unit);
            }
            if !counts.is_empty() {
                let texts =
                    counts.iter().map(|(name, (below, above))| format!("{} of {name}", count(below + above)));
                notes.push(format!("beyond the axis: {}", texts.collect::<Vec<_>>().join(", ")));
            }
            plots.push(plot);
        }
        let key = |(curve, _): (&CumulativeCurve, _)| {
            Key::new(
                Swatch::Curve(curve.line.clone(), curve.mark.0, curve.mark.1.clone()),
                curve.name.clone(),
            )
        };
        let legend = if self.curves.len() > 1 { self.shown_curves().map(key).collect() } else { Vec::new() };
        Figure { title: self.title.clone(), legend, notes, plots, ..Figure::default() }
    }

    /// Returns the line and the mark of the curve with this index. A single curve has no mark.
    fn curve_items(&self, plot: &Plot, index: usize, curve: &CumulativeCurve) -> Vec<Item> {
        let values = curve.values.values();
        let point = |index: usize| {
            let share = (index + 1) as f64 / values.len() as f64;
            let at = plot.at(values[index] * self.unit.per_si, share * 100.0);
            (at.x, at.y)
        };
        let last = values.len().saturating_sub(1);
        // Points at evenly spaced indexes are evenly spaced in height, so a long tail gets no more points than it
        // needs.
        let steps = CURVE_POINTS.min(last.max(1));
        let mut points: Vec<(f64, f64)> = (0..=steps).map(|step| point(last * step / steps)).collect();
        // The curve begins at a share of zero, straight below its first value.
        points.insert(0, (points[0].0, 1.0));
        let mark_y = 1.0 - (FIRST_MARK_HEIGHT + MARK_DISTANCE * index as f64).fract();
        // The mark lies on the point that is nearest to this height.
        let mark_point =
            points.iter().min_by(|a, b| (a.1 - mark_y).abs().total_cmp(&(b.1 - mark_y).abs())).copied();
        let mut items = vec![Item::path(Path::line(points.into_iter().map(Some)), curve.line.clone())];
        if self.curves.len() > 1 {
            let (shape, style) = &curve.mark;
            items.extend(
                mark_point
                    .map(|(x, y)| Item::mark(crate::plot::At::new(x, y), *shape, RADIUS, style.clone())),
            );
        }
        items
    }
}
