//! Median and 99th percentile of a latency in words.

use peernet_statistics::number::milliseconds;

/// Formats the median and the 99th percentile, both in seconds: `p50 101 ms, p99 104 ms`.
pub(crate) fn describe_quantiles(p50: f64, p99: Option<f64>) -> String {
    let p99 = p99.map_or_else(String::new, |p99| format!(", p99 {} ms", milliseconds(p99)));
    format!("p50 {} ms{p99}", milliseconds(p50))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_percentile_is_left_out() {
        assert_eq!(
            [describe_quantiles(0.1012, None), describe_quantiles(0.1012, Some(0.104))],
            ["p50 101 ms", "p50 101 ms, p99 104 ms"]
        );
    }
}
