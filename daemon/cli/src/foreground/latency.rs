//! Median and 99th percentile of a latency while it is being measured.

use peernet_analysis::order::MIN_VALUES_FOR_P99;
use peernet_statistics::Summary;
use peernet_statistics::number::milliseconds;

/// Returns the 99th percentile if there are enough values for it.
pub(crate) fn p99(latency: &Summary) -> Option<f64> {
    latency.quantile(0.99).filter(|_| latency.count() >= MIN_VALUES_FOR_P99 as u64)
}

/// Formats the median and the 99th percentile, both in seconds: `p50 101 ms, p99 104 ms`.
pub(crate) fn describe_quantiles(p50: f64, p99: Option<f64>) -> String {
    let p99 = p99.map_or_else(String::new, |p99| format!(", p99 {} ms", milliseconds(p99)));
    format!("p50 {} ms{p99}", milliseconds(p50))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tail_needs_enough_values() {
        let mut latency = Summary::default();
        (1..MIN_VALUES_FOR_P99).for_each(|_| latency.record(0.1));
        assert_eq!(p99(&latency), None);
        latency.record(0.1);
        // All values are equal: a quantile from only the sketch could differ by up to 1 %.
        assert_eq!(p99(&latency), Some(0.1));
        assert_eq!(
            [describe_quantiles(0.1012, None), describe_quantiles(0.1012, Some(0.104))],
            ["p50 101 ms", "p50 101 ms, p99 104 ms"]
        );
    }
}
