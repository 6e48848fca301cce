//! The part of an offset that a steady drift explains, so that a chart can subtract it.

use std::collections::BTreeMap;

use peernet_analysis::fit::{Point, theil_sen};
use peernet_analysis::order::SortedValues;
use peernet_clock::WallTime;
use peernet_store::ClockPoint;

use super::estimate_and_half_width;

/// Straight lines through the estimates: one line for each window. A new window begins after each clock step.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trend {
    lines: BTreeMap<u64, Line>,
}

#[derive(Clone, Copy, Debug)]
struct Line {
    /// Time of the middle estimate.
    middle: WallTime,
    /// Value of the line at `middle`, seconds.
    level: f64,
    /// Growth in seconds per second.
    slope: f64,
}

impl Trend {
    /// Fits the trend to points.
    pub(crate) fn of(points: &[ClockPoint]) -> Self {
        let mut windows: BTreeMap<u64, Vec<(WallTime, f64)>> = BTreeMap::new();
        for point in points {
            if let Some(offset) =
                point.offset.as_ref().filter(|offset| estimate_and_half_width(offset).is_some())
            {
                windows.entry(point.window).or_default().push((offset.at, offset.estimate.seconds()));
            }
        }
        let lines =
            windows.into_iter().filter_map(|(window, estimates)| Some((window, Line::through(&estimates)?)));
        Self { lines: lines.collect() }
    }

    /// Returns the value of the trend at a time, seconds; zero without a trend.
    pub(crate) fn at(&self, window: u64, at: WallTime) -> f64 {
        self.lines.get(&window).map_or(0.0, |line| line.level + line.slope * (at - line.middle).seconds())
    }
}

impl Line {
    /// Fits a line by the Theil–Sen estimator, which a few outliers do not affect. With too few points the line is horizontal.
    fn through(estimates: &[(WallTime, f64)]) -> Option<Self> {
        let middle = estimates.get(estimates.len() / 2)?.0;
        let points: Vec<Point> =
            estimates.iter().map(|(at, value)| Point { x: (*at - middle).seconds(), y: *value }).collect();
        let horizontal =
            || Some((points.iter().map(|point| point.y).collect::<SortedValues>().median()?, 0.0));
        let fit = theil_sen(&points).map(|fit| (fit.intercept.value, fit.slope.value));
        let (level, slope) = fit.or_else(horizontal)?;
        Some(Self { middle, level, slope })
    }
}
