//! Straight lines through points, with confidence intervals.
//!
//! Delays have long tails: a message that waited behind others is late by any amount and never early by much. This has
//! consequences for a line of best fit:
//!
//! * [`least_squares`] over single delays depends on the square of every late delay, and its standard errors are only
//!   valid for normal errors. Over *medians*, each weighted by its precision, it is valid. Medians of many samples are
//!   nearly normal with any tail (the central limit theorem of order statistics), and the medians of large messages,
//!   which vary more, have smaller weights. The scale of the errors is estimated from the residuals, so a delay that is
//!   not quite linear in size makes the intervals wider.
//! * [`theil_sen`] computes the median of the slopes of all pairs. Up to 29 % of the points may be arbitrarily wrong.
//!   The intervals only assume that the deviations from the line have the same distribution.

mod least_squares;
mod theil_sen;

pub use least_squares::{WeightedPoint, least_squares};
use serde::Serialize;
pub use theil_sen::theil_sen;

/// Confidence of every interval.
pub const CONFIDENCE: f64 = 0.95;

/// Point that a line is fitted to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Value that was chosen, such as the size of a message.
    pub x: f64,
    /// Value that was measured at this x, such as the delay of the message.
    pub y: f64,
}

/// Estimate with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Estimated value.
    pub value: f64,
    /// Standard error; `None` if the method does not give one.
    pub standard_error: Option<f64>,
    /// Ends of the interval; `None` when there are too few points for an interval.
    pub interval: Option<(f64, f64)>,
}

impl Estimate {
    /// Returns the distance from the value to the farther end of the interval, which is half the width if the value is
    /// in the middle. `None` without an interval.
    pub fn margin(&self) -> Option<f64> {
        self.interval.map(|(lo, hi)| (hi - self.value).max(self.value - lo))
    }

    /// Returns the ends of the interval; without an interval, both ends are the value.
    pub fn span(&self) -> (f64, f64) {
        self.interval.unwrap_or((self.value, self.value))
    }
}

/// Line of best fit: `y = intercept + slope · x`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Fit {
    /// Value of y at x = 0.
    pub intercept: Estimate,
    /// Growth of y with x.
    pub slope: Estimate,
    /// Number of points that the line was fitted to.
    pub points: usize,
}

impl Fit {
    /// Returns the value of the line at `x`.
    pub fn at(&self, x: f64) -> f64 {
        self.intercept.value + self.slope.value * x
    }
}

/// Maximum width of the interval of a slope or a rate, as a share of this value. A value with a wider interval is not
/// shown as one number.
pub(crate) const MAX_RELATIVE_WIDTH: f64 = 0.5;

/// Rate that follows from a slope in seconds per byte, bits per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlopeRate {
    /// Reciprocal of the slope.
    pub value: f64,
    /// Reciprocals of the ends of the slope's interval. The upper end is `None` if the interval of the slope reaches
    /// zero.
    pub interval: Option<(f64, Option<f64>)>,
}

impl SlopeRate {
    /// Returns the rate of a slope; `None` unless the slope is above 0.
    pub fn new(slope: Estimate) -> Option<Self> {
        Some(Self { value: rate_of(slope.value)?, interval: slope.interval.and_then(rate_range) })
    }

    /// Returns the rate and the margin of its 95 % interval. `None` if the interval is not known, has no upper end, or
    /// is wider than half the rate.
    pub fn with_margin(self) -> Option<(f64, f64)> {
        let (low, high) = self.interval?;
        let (rate, high) = (self.value, high?);
        (high - low <= MAX_RELATIVE_WIDTH * rate).then(|| (rate, (high - rate).max(rate - low)))
    }
}

/// Returns the rate of a slope and the rate's margin; `None` unless the slope is above 0 and [`SlopeRate::with_margin`]
/// returns a rate.
pub fn rate(slope: Estimate) -> Option<(f64, f64)> {
    SlopeRate::new(slope)?.with_margin()
}

/// Converts a slope in seconds per byte into bits per second; `None` unless the slope is above 0.
fn rate_of(slope: f64) -> Option<f64> {
    (slope > 0.0).then(|| 8.0 / slope)
}

/// Returns the lowest and the highest rate for slopes in this range. The highest rate is `None` if the lowest slope is
/// not positive.
pub(crate) fn rate_range((low_slope, high_slope): (f64, f64)) -> Option<(f64, Option<f64>)> {
    Some((rate_of(high_slope)?, rate_of(low_slope)))
}

/// Returns whether a line can be fitted: there are at least three points, not all of them have the same x, and all
/// coordinates are finite.
fn can_be_fitted(points: impl IntoIterator<Item = Point>) -> bool {
    let points: Vec<Point> = points.into_iter().collect();
    points.len() >= 3
        && points.iter().all(|point| point.x.is_finite() && point.y.is_finite())
        && points.iter().any(|point| point.x != points[0].x)
}

#[cfg(test)]
mod tests;
