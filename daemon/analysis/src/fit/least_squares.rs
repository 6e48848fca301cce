//! Line fit by least squares.

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{CONFIDENCE, Estimate, Fit, Point, can_be_fitted};

/// Point with its weight: the reciprocal of the variance of `y`, in any unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighted {
    /// The point.
    pub point: Point,
    /// Weight, above 0.
    pub weight: f64,
}

impl From<Point> for Weighted {
    fn from(point: Point) -> Self {
        Self { point, weight: 1.0 }
    }
}

/// Returns the line with the smallest weighted sum of squared deviations. Intervals follow Student's distribution with n − 2 degrees of
/// freedom; the scale of the errors is estimated from the residuals (Draper and Smith, Applied Regression Analysis, chapters 1 and 9).
/// `None` when there are fewer than three points or all have the same x.
pub fn least_squares(points: &[Weighted]) -> Option<Fit> {
    let usable = points.iter().all(|point| point.weight.is_finite() && point.weight > 0.0);
    if !usable || !can_be_fitted(points.iter().map(|point| point.point)) {
        return None;
    }
    let sum =
        |term: &dyn Fn(&Weighted) -> f64| points.iter().map(|point| point.weight * term(point)).sum::<f64>();
    let weight = sum(&|_| 1.0);
    let (x, y) = (sum(&|w| w.point.x) / weight, sum(&|w| w.point.y) / weight);
    let xx = sum(&|w| (w.point.x - x).powi(2));
    let slope = sum(&|w| (w.point.x - x) * (w.point.y - y)) / xx;
    let intercept = y - slope * x;

    let freedom = (points.len() - 2) as f64;
    let variance = sum(&|w| (w.point.y - intercept - slope * w.point.x).powi(2)) / freedom;
    let t = StudentsT::new(0.0, 1.0, freedom).ok()?.inverse_cdf(f64::midpoint(1.0, CONFIDENCE));
    let estimate = |value: f64, error: f64| Estimate {
        value,
        standard_error: Some(error),
        interval: Some((value - t * error, value + t * error)),
    };
    Some(Fit {
        intercept: estimate(intercept, (variance * (1.0 / weight + x * x / xx)).sqrt()),
        slope: estimate(slope, (variance / xx).sqrt()),
        points: points.len(),
    })
}
