//! Moments and quantiles of one quantity.

use serde::{Deserialize, Serialize};

use crate::{Merge, Moments, Sketch};

/// Minimum number of values for p5 and p95, everywhere in PEERNet.
pub const MIN_VALUES_FOR_P95: u64 = 60;
/// Number of values that a point of a line over time should have, everywhere in PEERNet: a tenth more than p95 needs,
/// because values are not spread evenly over the points.
pub const VALUES_PER_POINT: u64 = MIN_VALUES_FOR_P95 + MIN_VALUES_FOR_P95 / 10;
/// Minimum number of values for p99, everywhere in PEERNet.
pub const MIN_VALUES_FOR_P99: u64 = 300;

/// Summary of a quantity, in bounded memory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Moments, exact up to rounding.
    pub moments: Moments,
    /// Quantiles with a relative error of at most [`Sketch::RELATIVE_ERROR`].
    pub sketch: Sketch,
}

impl Summary {
    /// Returns whether a number is recorded; see [`Moments::accepts`].
    #[inline]
    pub fn accepts(value: f64) -> bool {
        Moments::accepts(value)
    }

    /// Adds a number if it is [accepted](Self::accepts).
    #[inline]
    pub fn record(&mut self, value: f64) {
        if Self::accepts(value) {
            self.moments.record(value);
            self.sketch.record(value);
        }
    }

    /// Adds all numbers of another summary.
    pub fn merge(&mut self, other: &Self) {
        self.moments.merge(&other.moments);
        self.sketch.merge(&other.sketch);
    }

    /// Returns the number of recorded numbers.
    pub fn count(&self) -> u64 {
        self.moments.count
    }

    /// Returns the quantile at `q` from 0 to 1: the number below which the fraction `q` of all numbers lies. The
    /// result is never outside of the observed extremes. `None` without numbers.
    pub fn quantile(&self, q: f64) -> Option<f64> {
        // The midpoint of the lowest or the highest bin may lie beyond the smallest or the largest number.
        self.sketch.quantile(q).map(|value| value.max(self.moments.min).min(self.moments.max))
    }

    /// Returns the 5th and the 95th percentile; `None` with fewer than [`MIN_VALUES_FOR_P95`] numbers.
    pub fn tails(&self) -> Option<(f64, f64)> {
        Some((self.quantile(0.05)?, self.p95()?))
    }

    /// Returns the 95th percentile; `None` with fewer than [`MIN_VALUES_FOR_P95`] numbers.
    pub fn p95(&self) -> Option<f64> {
        self.quantile(0.95).filter(|_| self.count() >= MIN_VALUES_FOR_P95)
    }

    /// Returns the 99th percentile; `None` with fewer than [`MIN_VALUES_FOR_P99`] numbers.
    pub fn p99(&self) -> Option<f64> {
        self.quantile(0.99).filter(|_| self.count() >= MIN_VALUES_FOR_P99)
    }

    /// Returns the share of numbers below `x`, 0 to 1. The share is exactly 0 if `x` is at most the smallest number,
    /// and exactly 1 if `x` is above the largest. `None` without numbers.
    pub fn fraction_below(&self, x: f64) -> Option<f64> {
        // The outermost bins of the sketch extend beyond the extremes.
        if x <= self.moments.min {
            (self.count() > 0).then_some(0.0)
        } else if x > self.moments.max {
            (self.count() > 0).then_some(1.0)
        } else {
            self.sketch.fraction_below(x)
        }
    }
}

impl Merge for Summary {
    fn merge(&mut self, other: &Self) {
        // The inherent method has the same name. It can be called without the trait in scope.
        Self::merge(self, other);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_MAGNITUDE;

    #[test]
    fn quantiles_stay_within_the_observed_extremes() {
        let mut summary = Summary::default();
        summary.record(0.0101);
        assert_eq!((summary.quantile(0.0), summary.quantile(1.0)), (Some(0.0101), Some(0.0101)));
        assert_eq!((summary.fraction_below(0.0101), summary.fraction_below(0.0102)), (Some(0.0), Some(1.0)));
    }

    #[test]
    fn tail_percentiles_need_enough_numbers() {
        let mut summary = Summary::default();
        let mut percentiles_after = |count: u64| {
            (summary.count()..count).for_each(|_| summary.record(0.1));
            (summary.tails(), summary.p95(), summary.p99())
        };
        assert_eq!(percentiles_after(59), (None, None, None));
        // All numbers are equal: a quantile from only the sketch could differ by up to 1 %.
        assert_eq!(percentiles_after(60), (Some((0.1, 0.1)), Some(0.1), None));
        assert_eq!(percentiles_after(299).2, None);
        assert_eq!(percentiles_after(300).2, Some(0.1));
    }

    #[test]
    fn out_of_range_numbers_are_excluded_everywhere() {
        let mut summary = Summary::default();
        let out_of_range = [f64::NAN, f64::INFINITY, f64::MAX, -f64::MAX, 1.001 * MAX_MAGNITUDE];
        out_of_range.iter().for_each(|value| summary.record(*value));
        summary.record(1.0);
        assert_eq!((summary.count(), summary.sketch.count()), (1, 1));
    }

    #[test]
    fn moments_of_largest_numbers_survive_serialization() {
        let mut summary = Summary::default();
        [MAX_MAGNITUDE, -MAX_MAGNITUDE, 1.0].iter().for_each(|value| summary.record(*value));
        (0..20).for_each(|_| summary.merge(&summary.clone()));
        let bytes = rmp_serde::to_vec(&summary).expect("serialises");
        assert_eq!(rmp_serde::from_slice::<Summary>(&bytes).expect("reads back"), summary);
    }
}
