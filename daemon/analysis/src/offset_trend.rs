//! The part of an offset between two clocks that a steady drift explains, so that a chart can subtract it.

use std::collections::BTreeMap;

use peernet_clock::{Offset, WallTime};

use crate::clock_points::ClockPoint;
use crate::fit::{Point, theil_sen};
use crate::order::SortedValues;

/// Returns the estimate of an offset and the largest error of the estimate, seconds. The largest error is the larger of
/// the distances from the estimate to the two bounds, because the estimate is seldom in their middle. `None` if sources
/// or exchanges contradict each other: such an offset has no value.
pub fn estimate_and_max_error(offset: &Offset) -> Option<(f64, f64)> {
    let [estimate, lo, hi] = [offset.estimate, offset.bounds.lo, offset.bounds.hi].map(|span| span.seconds());
    offset.is_consistent().then(|| (estimate, (hi - estimate).max(estimate - lo)))
}

/// Straight lines through the estimates of an offset: one line for each relation period. A new relation period begins
/// after each clock step.
#[derive(Clone, Debug, Default)]
pub struct OffsetTrend {
    lines: BTreeMap<u64, Line>,
}

#[derive(Clone, Copy, Debug)]
struct Line {
    /// Time of the middle estimate.
    middle: WallTime,
    /// Value of the line at `middle`, seconds.
    level: f64,
    /// Growth of the offset, in seconds per second.
    slope: f64,
}

impl OffsetTrend {
    /// Fits the lines to the offsets of these points.
    pub fn of(points: &[ClockPoint]) -> Self {
        let mut relation_periods: BTreeMap<u64, Vec<(WallTime, f64)>> = BTreeMap::new();
        for point in points {
            if let Some(offset) = point.offset.as_ref().filter(|offset| offset.is_consistent()) {
                relation_periods
                    .entry(point.relation_period)
                    .or_default()
                    .push((offset.at, offset.estimate.seconds()));
            }
        }
        let lines = relation_periods
            .into_iter()
            .filter_map(|(relation_period, estimates)| Some((relation_period, Line::through(&estimates)?)));
        Self { lines: lines.collect() }
    }

    /// Returns the value of a relation period's line at a time, seconds; 0 if the relation period has no line.
    pub fn at(&self, relation_period: u64, at: WallTime) -> f64 {
        self.lines
            .get(&relation_period)
            .map_or(0.0, |line| line.level + line.slope * (at - line.middle).seconds())
    }
}

impl Line {
    /// Fits a line by the Theil–Sen estimator, which a few outliers do not affect. With too few points for a slope, the
    /// line is horizontal at the median. `None` without points.
    fn through(estimates: &[(WallTime, f64)]) -> Option<Self> {
        let middle = estimates.get(estimates.len() / 2)?.0;
        // Times are counted from the middle: a slope times the seconds since 1970 would be so large that few digits
        // remain for the level.
        let points: Vec<Point> =
            estimates.iter().map(|(at, value)| Point { x: (*at - middle).seconds(), y: *value }).collect();
        let horizontal =
            || Some((points.iter().map(|point| point.y).collect::<SortedValues>().median()?, 0.0));
        let fit = theil_sen(&points).map(|fit| (fit.intercept.value, fit.slope.value));
        let (level, slope) = fit.or_else(horizontal)?;
        Some(Self { middle, level, slope })
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::Span;

    use super::*;

    #[test]
    fn line_through_two_estimates_is_horizontal() {
        let at = |second: i64| WallTime::from_unix_nanos(second * 1_000_000_000);
        let line = Line::through(&[(at(0), 1.0), (at(10), 3.0)]).expect("estimates");
        assert_eq!((line.level, line.slope), (2.0, 0.0));
    }

    #[test]
    fn line_has_slope_of_steady_drift() {
        let at = |second: i64| WallTime::from_unix_nanos(second * 1_000_000_000);
        let drift = |second: i64| (at(second), 1e-6 * second as f64);
        let line = Line::through(&(0..20).map(drift).collect::<Vec<_>>()).expect("estimates");
        assert!(
            (line.slope - 1e-6).abs() < 1e-12 && line.middle == at(0) + Span::from_seconds(10),
            "{line:?}"
        );
    }

    #[test]
    fn trend_without_points_is_zero() {
        assert_eq!(OffsetTrend::of(&[]).at(1, WallTime::from_unix_nanos(5_000_000_000)), 0.0);
    }
}
