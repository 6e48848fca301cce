//! Count, mean, variance and extremes, updated one number at a time.

use serde::{Deserialize, Serialize};

/// Count, mean, sum of squared deviations from the mean, and extremes.
///
/// Welford 1962 for single numbers, Chan, Golub and LeVeque 1979 for merging: sums of squares would cancel
/// when the mean is large beside the deviation, as it is for durations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Moments {
    /// How many numbers.
    pub count: u64,
    /// Their mean; 0 when there are none.
    pub mean: f64,
    /// Sum of squared deviations from the mean.
    pub m2: f64,
    /// The smallest; 0 when there are none.
    pub min: f64,
    /// The largest; 0 when there are none.
    pub max: f64,
}

impl Moments {
    /// Adds a number. Not-a-number and infinities are the caller's to keep out.
    pub fn record(&mut self, value: f64) {
        self.merge(&Self { count: 1, mean: value, m2: 0.0, min: value, max: value });
    }

    /// Adds all numbers of another.
    pub fn merge(&mut self, other: &Self) {
        if other.count == 0 {
            return;
        }
        if self.count == 0 {
            *self = *other;
            return;
        }
        let (n, m) = (self.count as f64, other.count as f64);
        let difference = other.mean - self.mean;
        self.count += other.count;
        self.mean += difference * m / (n + m);
        self.m2 += other.m2 + difference * difference * n * m / (n + m);
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
    }

    /// Sample variance; `None` below two numbers.
    pub fn variance(&self) -> Option<f64> {
        (self.count > 1).then(|| self.m2 / (self.count - 1) as f64)
    }

    /// Sample standard deviation; `None` below two numbers.
    pub fn std(&self) -> Option<f64> {
        self.variance().map(f64::sqrt)
    }
}
