//! Block length of a bootstrap. Blocks are so long that correlated neighbours stay together.

/// Returns the mean block length of a stationary bootstrap of the mean of these values, at least 1.
///
/// Consecutive latencies are correlated: a queue empties slowly, a processor stays warm. If latencies were drawn one by
/// one, the interval would be too narrow. The returned length minimises the error of the bootstrapped variance (Politis
/// and White, *Automatic block-length selection for the dependent bootstrap*, Econometric Reviews 23, 2004, as
/// corrected by Patton, Politis and White, Econometric Reviews 28, 2009). With the autocovariance R, the flat-top
/// window function λ, its width M, G = Σ λ(k/M) |k| R(k) and σ² = Σ λ(k/M) R(k), the length is (G² / σ⁴ · n)^⅓, at most
/// 3 √n and n / 3. For independent values the length is about 1, and the bootstrap is the ordinary bootstrap.
pub(super) fn length(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let longest = (3.0 * n.sqrt()).min(n / 3.0).ceil().max(1.0);
    let mean = values.iter().sum::<f64>() / n;
    let centred: Vec<f64> = values.iter().map(|value| value - mean).collect();
    let Some(window) = window(&centred) else { return 1.0 };
    let flat_top = |lag: usize| (2.0 * (1.0 - lag as f64 / window as f64)).clamp(0.0, 1.0);
    let (mut g, mut variance) = (0.0, covariance(&centred, 0));
    // R and λ are the same at a lag and at its negative, so each positive lag counts twice.
    for lag in 1..=window.min(values.len().saturating_sub(1)) {
        let weighted = 2.0 * flat_top(lag) * covariance(&centred, lag);
        g += lag as f64 * weighted;
        variance += weighted;
    }
    let length = (g * g / (variance * variance) * n).cbrt();
    if length.is_finite() { length.clamp(1.0, longest) } else { 1.0 }
}

/// Returns the width of the window: twice the smallest lag after which the values are not correlated, which means that
/// the next five or more correlations lie within ±2 √(log₁₀ n / n). The width is at most the
/// largest lag that is examined, which is about √n + 5. `None` if the values do not vary.
fn window(centred: &[f64]) -> Option<usize> {
    let n = centred.len() as f64;
    let variance = covariance(centred, 0);
    (variance > 0.0).then_some(())?;
    let required_lags = (n.log10() as usize).max(5);
    let max_lag = n.sqrt().ceil() as usize + required_lags;
    let limit = 2.0 * (n.log10() / n).sqrt();
    let mut uncorrelated_lags = 0;
    for lag in 1..=max_lag {
        let is_uncorrelated = (covariance(centred, lag) / variance).abs() < limit;
        uncorrelated_lags = if is_uncorrelated { uncorrelated_lags + 1 } else { 0 };
        if uncorrelated_lags == required_lags {
            return Some((2 * (lag - required_lags)).max(2).min(max_lag));
        }
    }
    Some(max_lag)
}

/// Returns the autocovariance of values with the mean 0 at a lag.
fn covariance(centred: &[f64], lag: usize) -> f64 {
    let pairs = centred.iter().zip(centred.iter().skip(lag));
    pairs.map(|(a, b)| a * b).sum::<f64>() / centred.len() as f64
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    /// Returns a first-order autoregressive series with the coefficient `correlation`.
    fn autoregressive(correlation: f64, count: usize) -> Vec<f64> {
        let mut random = StdRng::seed_from_u64(5);
        let mut last = 0.0;
        let next = |_| {
            last = correlation * last + random.random_range(-1.0..1.0);
            last
        };
        (0..count).map(next).collect()
    }

    #[test]
    fn block_length_grows_with_autocorrelation() {
        let lengths = [0.0, 0.5, 0.9].map(|correlation| length(&autoregressive(correlation, 4000)));
        assert!(lengths[0] < 6.0, "{lengths:?}");
        // In theory, the length is the cube root of (2 φ / (1 − φ²))² n, which is 19.2 and 71 for n = 4000. An estimate
        // from 4000 values differs from it.
        assert!((12.0..30.0).contains(&lengths[1]), "{lengths:?}");
        assert!((45.0..110.0).contains(&lengths[2]), "{lengths:?}");
    }

    #[test]
    fn constant_values_have_block_length_one() {
        assert_eq!((length(&[2.0; 50]), length(&[1.0]), length(&[])), (1.0, 1.0, 1.0));
    }
}
