//! Line fit by least squares.

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{CONFIDENCE, Estimate, Fit, Point, can_be_fitted};

/// Point with its weight. Weights are proportional to the reciprocal of the variance of `y`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedPoint {
    /// The point.
    pub point: Point,
    /// Weight, above 0.
    pub weight: f64,
}

impl From<Point> for WeightedPoint {
    fn from(point: Point) -> Self {
        Self { point, weight: 1.0 }
    }
}

/// Returns the line with the smallest weighted sum of squared deviations. Intervals follow Student's distribution with
/// n − 2 degrees of freedom; the scale of the errors is estimated from the residuals (Draper and Smith, Applied
/// Regression Analysis, chapters 1 and 9). `None` if there are fewer than three points, if all points have the same x,
/// or if a coordinate or a weight is not valid.
pub fn least_squares(points: &[WeightedPoint]) -> Option<Fit> {
    let are_weights_valid = points.iter().all(|point| point.weight.is_finite() && point.weight > 0.0);
    if !are_weights_valid || !can_be_fitted(points.iter().map(|point| point.point)) {
        return None;
    }
    let sum = |term: &dyn Fn(&WeightedPoint) -> f64| {
        points.iter().map(|point| point.weight * term(point)).sum::<f64>()
    };
    let total_weight = sum(&|_| 1.0);
    let (mean_x, mean_y) = (sum(&|w| w.point.x) / total_weight, sum(&|w| w.point.y) / total_weight);
    // The sums are taken over deviations from the means: differences of sums of squares would lose digits.
    let sum_xx = sum(&|w| (w.point.x - mean_x).powi(2));
    let slope = sum(&|w| (w.point.x - mean_x) * (w.point.y - mean_y)) / sum_xx;
    let intercept = mean_y - slope * mean_x;

    let degrees_of_freedom = (points.len() - 2) as f64;
    let variance = sum(&|w| (w.point.y - intercept - slope * w.point.x).powi(2)) / degrees_of_freedom;
    let t = StudentsT::new(0.0, 1.0, degrees_of_freedom).ok()?.inverse_cdf(f64::midpoint(1.0, CONFIDENCE));
    let estimate = |value: f64, error: f64| Estimate {
        value,
        standard_error: Some(error),
        interval: Some((value - t * error, value + t * error)),
    };
    Some(Fit {
        intercept: estimate(intercept, (variance * (1.0 / total_weight + mean_x * mean_x / sum_xx)).sqrt()),
        slope: estimate(slope, (variance / sum_xx).sqrt()),
        points: points.len(),
    })
}
