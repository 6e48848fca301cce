//! Series for the tests of intervals.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

/// Returns values of a run. The deviation of each value from the mean is `correlation` times the previous deviation,
/// plus noise.
pub(super) fn autocorrelated_values(correlation: f64, count: usize, mean: f64, seed: u64) -> Vec<f64> {
    let mut random = StdRng::seed_from_u64(seed);
    let mut last = 0.0;
    let next = |_| {
        // The sum of three uniform values is nearly normal.
        let noise: f64 = (0..3).map(|_| random.random_range(-1.0..1.0)).sum();
        last = correlation * last + noise;
        mean + last
    };
    (0..count).map(next).collect()
}
