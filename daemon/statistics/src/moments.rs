//! Count, mean, variance and extremes, updated one number at a time.

use serde::{Deserialize, Serialize};

use crate::{MAX_MAGNITUDE, Merge};

/// Count, mean, sum of squared deviations from the mean, and extremes.
///
/// Numbers are added by Welford's method (1962), and instances are merged by the method of Chan, Golub and LeVeque
/// (1979).
// Sums of squares would lose precision if the mean is much larger than the deviation, as is usual for durations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "UncheckedMoments")]
pub struct Moments {
    /// Number of values.
    pub count: u64,
    /// Mean; 0 if there are no values.
    pub mean: f64,
    /// Sum of squared deviations from the mean.
    pub m2: f64,
    /// Smallest value; 0 if there are no values.
    pub min: f64,
    /// Largest value; 0 if there are no values.
    pub max: f64,
}

impl Moments {
    /// Returns whether a number is recorded: it must be finite, and small enough that squares can be added.
    // Some drivers report the largest floating-point number if a reading is missing.
    #[inline]
    pub fn accepts(value: f64) -> bool {
        value.abs() <= MAX_MAGNITUDE
    }

    /// Adds a number. The caller must leave out numbers that [`accepts`](Self::accepts) rejects.
    #[inline]
    pub fn record(&mut self, value: f64) {
        if self.count == 0 {
            *self = Self { count: 1, mean: value, m2: 0.0, min: value, max: value };
            return;
        }
        self.count += 1;
        let difference = value - self.mean;
        self.mean += difference / self.count as f64;
        self.m2 += difference * (value - self.mean);
        self.min = self.min.min(value);
        self.max = self.max.max(value);
    }

    /// Adds all numbers of another instance.
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

    /// Returns the sum of the values.
    pub fn sum(&self) -> f64 {
        self.mean * self.count as f64
    }

    /// Returns the sample variance; `None` for fewer than two numbers.
    pub fn variance(&self) -> Option<f64> {
        (self.count > 1).then(|| self.m2 / (self.count - 1) as f64)
    }

    /// Returns the sample standard deviation; `None` for fewer than two numbers.
    pub fn std(&self) -> Option<f64> {
        self.variance().map(f64::sqrt)
    }
}

/// Moments from an untrusted source, before they are checked.
// A NaN would invalidate all statistics that it is merged into.
#[derive(Deserialize)]
struct UncheckedMoments {
    count: u64,
    mean: f64,
    m2: f64,
    min: f64,
    max: f64,
}

impl TryFrom<UncheckedMoments> for Moments {
    type Error = &'static str;

    fn try_from(received: UncheckedMoments) -> Result<Self, &'static str> {
        let UncheckedMoments { count, mean, m2, min, max } = received;
        let are_in_range = [mean, min, max].iter().all(|number| number.abs() <= crate::MAX_MAGNITUDE);
        let is_m2_valid = m2.is_finite() && m2 >= 0.0;
        if are_in_range && is_m2_valid && min <= max && count <= crate::MAX_COUNT {
            Ok(Self { count, mean, m2, min, max })
        } else {
            Err(
                "inconsistent moments: a number is not finite or too large, the minimum is above the maximum, \
                 or the sum of squares is negative",
            )
        }
    }
}

impl FromIterator<f64> for Moments {
    /// Collects numbers. Numbers that [`accepts`](Moments::accepts) rejects are left out.
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut moments = Self::default();
        let accepted = values.into_iter().filter(|value| Self::accepts(*value));
        accepted.for_each(|value| moments.record(value));
        moments
    }
}

impl Merge for Moments {
    fn merge(&mut self, other: &Self) {
        // The inherent method has the same name. It can be called without the trait in scope.
        Self::merge(self, other);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn moments_of(values: &[f64]) -> Moments {
        values.iter().copied().collect()
    }

    /// Computes mean and sample variance in two passes.
    fn two_passes(values: &[f64]) -> (f64, f64) {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let squared_deviations: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        (mean, squared_deviations / (values.len() - 1) as f64)
    }

    fn are_close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
    }

    /// Durations around a mean that is much larger than their deviation, where sums of squares lose precision.
    fn durations() -> impl Strategy<Value = Vec<f64>> {
        (1e-3..10.0_f64, prop::collection::vec(-1.0..1.0_f64, 2..300))
            .prop_map(|(mean, noise)| noise.iter().map(|noise| mean * (1.0 + 1e-3 * noise)).collect())
    }

    proptest! {
        #[test]
        fn moments_equal_those_of_two_passes(values in durations()) {
            let (mean, variance) = two_passes(&values);
            let moments = moments_of(&values);
            prop_assert!(are_close(moments.mean, mean));
            prop_assert!(are_close(moments.variance().expect("two or more"), variance));
            prop_assert_eq!(moments.count, values.len() as u64);
            prop_assert_eq!(moments.min, values.iter().copied().fold(f64::MAX, f64::min));
            prop_assert_eq!(moments.max, values.iter().copied().fold(f64::MIN, f64::max));
        }

        #[test]
        fn merged_moments_equal_those_of_two_passes(values in durations(), piece_length in 1_usize..20) {
            let mut merged = Moments::default();
            for piece in values.chunks(piece_length) {
                merged.merge(&moments_of(piece));
            }
            let (mean, variance) = two_passes(&values);
            prop_assert!(are_close(merged.mean, mean));
            prop_assert!(are_close(merged.variance().expect("two or more"), variance));
            prop_assert!(are_close(merged.sum(), values.iter().sum()));
        }
    }

    #[test]
    fn inconsistent_moments_are_refused() {
        let good = moments_of(&[1.0, 2.0]);
        let nan = Moments { mean: f64::NAN, ..good };
        let min_above_max = Moments { min: 3.0, ..good };
        let encode = |moments| rmp_serde::to_vec(&moments).expect("serialises");
        assert_eq!(rmp_serde::from_slice::<Moments>(&encode(good)).expect("reads back"), good);
        assert!(rmp_serde::from_slice::<Moments>(&encode(nan)).is_err());
        assert!(rmp_serde::from_slice::<Moments>(&encode(min_above_max)).is_err());
    }

    #[test]
    fn collecting_leaves_out_numbers_out_of_range() {
        let with_invalid = [1.0, f64::NAN, f64::INFINITY, f64::MAX, 2.0];
        assert_eq!(moments_of(&with_invalid), moments_of(&[1.0, 2.0]));
    }

    #[test]
    fn merging_empty_moments_changes_nothing() {
        let mut moments = moments_of(&[2.0]);
        moments.merge(&Moments::default());
        assert_eq!((moments, moments.variance()), (moments_of(&[2.0]), None));
    }
}
