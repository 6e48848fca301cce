//! The difference of two means when neighbouring values depend on each other.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Fewest batches on each side.
pub const FEWEST: usize = 5;

/// A difference of two means with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// The second mean less the first.
    pub value: f64,
    /// Where it lies with 95 % confidence.
    pub interval: (f64, f64),
}

impl Difference {
    /// Of the means of batches of two runs (non-overlapping batch means, Schmeiser 1982): batches that are longer than
    /// what neighbouring iterations have in common are nearly independent, which single iterations are not. The interval
    /// is Welch's (1947), for unequal variances. `None` with fewer than five batches on a side.
    pub fn of_batches(first: &[f64], second: &[f64]) -> Option<Self> {
        let (a, b) = (Side::of(first)?, Side::of(second)?);
        let value = b.mean - a.mean;
        let variance = a.error + b.error;
        if variance <= 0.0 {
            return Some(Self { value, interval: (value, value) });
        }
        let freedom = variance.powi(2) / (a.error.powi(2) / a.freedom + b.error.powi(2) / b.freedom);
        let away = StudentsT::new(0.0, 1.0, freedom).ok()?.inverse_cdf(0.975) * variance.sqrt();
        Some(Self { value, interval: (value - away, value + away) })
    }

    /// The same interval about a difference that is known exactly: batches are not all of the same length, so that the mean
    /// of their means is not quite the mean of all.
    #[must_use]
    pub fn about(self, value: f64) -> Self {
        let shift = value - self.value;
        Self { value, interval: (self.interval.0 + shift, self.interval.1 + shift) }
    }

    /// Whether zero lies outside the interval: the runs differ by more than chance.
    pub fn is_certain(&self) -> bool {
        self.interval.0 > 0.0 || self.interval.1 < 0.0
    }
}

struct Side {
    mean: f64,
    /// Variance of the mean.
    error: f64,
    freedom: f64,
}

impl Side {
    fn of(batches: &[f64]) -> Option<Self> {
        let n = batches.len();
        (n >= FEWEST).then_some(())?;
        let count = n as f64;
        let mean = batches.iter().sum::<f64>() / count;
        let squares: f64 = batches.iter().map(|value| (value - mean).powi(2)).sum();
        Some(Self { mean, error: squares / (count - 1.0) / count, freedom: count - 1.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: variances of the means 0.5 and 0.583, 8.989 degrees of freedom, so 2.5 ± 2.26255 × 1.04083.
    #[test]
    fn the_interval_is_welchs() {
        let found = Difference::of_batches(&[1.0, 2.0, 3.0, 4.0, 5.0], &[3.0, 5.0, 4.0, 6.0, 7.0, 8.0]);
        let found = found.expect("enough");
        assert!((found.value - 2.5).abs() < 1e-12 && found.is_certain());
        let (lo, hi) = found.interval;
        assert!((lo - 0.145_05).abs() < 1e-4 && (hi - 4.854_95).abs() < 1e-4, "{lo} {hi}");
        assert!((lo + hi - 5.0).abs() < 1e-9, "symmetric");
        let moved = found.about(2.0);
        assert!(moved.value == 2.0 && (moved.interval.0 - (lo - 0.5)).abs() < 1e-12, "{moved:?}");
    }

    #[test]
    fn too_little_has_no_interval_and_equal_runs_do_not_differ() {
        assert_eq!(Difference::of_batches(&[1.0; 4], &[1.0; 9]), None);
        let same = Difference::of_batches(&[1.0; 9], &[1.0; 9]).expect("enough");
        assert!(!same.is_certain() && same.interval == (0.0, 0.0));
    }
}
