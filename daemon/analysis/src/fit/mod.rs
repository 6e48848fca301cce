//! Straight lines through points, with confidence intervals.
//!
//! Delays have long tails: a message that waited behind others is late by any amount and never early by much. This has
//! consequences for a line of best fit:
//!
//! * [`least_squares`] over single delays depends on every late one by its square, and its standard errors are only valid
//!   for normal errors. Over *medians*, each weighted by its precision, it is valid: medians of many samples are nearly
//!   normal with any tail (the central limit theorem of order statistics), and the medians of large messages, which vary
//!   more, have smaller weights. The scale of the errors is estimated from the residuals, so a delay that is not quite
//!   linear in size makes the intervals wider.
//! * [`theil_sen`] computes the median of the slopes of all pairs: up to 29 % of the points may be arbitrarily wrong, and
//!   its intervals only assume that deviations from the line have the same distribution.

mod least_squares;
mod means;
mod theil_sen;

pub use least_squares::{Weighted, least_squares};
pub use means::{MIN_SIZES, MeanAtSize, distinct_sizes, line_through_means};
use serde::Serialize;
pub use theil_sen::theil_sen;

/// The confidence of every interval.
pub const CONFIDENCE: f64 = 0.95;

/// Point to fit: a value that was set and one that was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Value that was set.
    pub x: f64,
    /// Value that was measured.
    pub y: f64,
}

/// Estimate with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The figure.
    pub value: f64,
    /// Standard error; `None` if the method has none.
    pub standard_error: Option<f64>,
    /// Ends of the interval; `None` when there are too few points for one.
    pub interval: Option<(f64, f64)>,
}

impl Estimate {
    /// Returns half the interval's width, or more if the figure is not in its middle.
    pub fn margin(&self) -> Option<f64> {
        self.interval.map(|(lo, hi)| (hi - self.value).max(self.value - lo))
    }

    /// Returns the interval, or the figure twice if it has no interval.
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
    /// Returns the line's value at `x`.
    pub fn at(&self, x: f64) -> f64 {
        self.intercept.value + self.slope.value * x
    }
}

/// Width of a rate's interval, as a share of the rate, above which no rate is given.
const MAX_RELATIVE_WIDTH: f64 = 0.5;

/// Returns the bits per second of a slope in seconds per byte, and the margin of its 95 % interval; `None` if the interval reaches zero or
/// is wider than half the rate.
pub fn rate(slope: Estimate) -> Option<(f64, f64)> {
    let (flat, steep) = slope.interval.filter(|(flat, _)| *flat > 0.0)?;
    let [rate, low, high] = [slope.value, steep, flat].map(|slope| 8.0 / slope);
    (high - low <= MAX_RELATIVE_WIDTH * rate).then(|| (rate, (high - rate).max(rate - low)))
}

/// Returns whether a line can be fitted: there are at least three points, they have two different x, and all coordinates are numbers.
fn can_be_fitted(points: impl IntoIterator<Item = Point>) -> bool {
    let points: Vec<Point> = points.into_iter().collect();
    points.len() >= 3
        && points.iter().all(|point| point.x.is_finite() && point.y.is_finite())
        && points.iter().any(|point| point.x != points[0].x)
}

#[cfg(test)]
mod tests;
