//! Formatting of estimates and their intervals, in ms.

use super::milliseconds::default_decimals;
use super::{decimals, fixed, has_nonzero_digit, join_ends, with_plus_sign};

/// Maximum number of decimals of an estimate in ms. The ninth decimal is one picosecond.
const MAX_DECIMALS: usize = 9;

/// Estimate with its interval, in ms. Both are shown down to the second significant digit of half the interval's width.
/// Unlike bounds from clocks, the interval may be arbitrarily narrow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Estimated value, ms.
    value: f64,
    /// Ends of the interval, ms.
    interval: (f64, f64),
    /// Number of decimals of all numbers.
    decimals: usize,
}

impl Estimate {
    /// Creates an estimate from seconds. If both ends of the interval are equal, the number of decimals follows from
    /// the size of the value.
    pub fn new(seconds: f64, (lo, hi): (f64, f64)) -> Self {
        let [value, lo, hi] = [seconds, lo, hi].map(|seconds| seconds * 1e3);
        let half_width = (hi - lo) / 2.0;
        let decimals = if half_width > 0.0 {
            decimals(half_width, 2).min(MAX_DECIMALS)
        } else {
            default_decimals(value)
        };
        Self { value, interval: (lo, hi), decimals }
    }

    /// Returns the estimate with this number of decimals, for example the number that all values of a column have.
    #[must_use]
    pub fn with_decimals(self, decimals: usize) -> Self {
        Self { decimals, ..self }
    }

    /// Formats the value without its unit: `0.0183`, `−0.00070`.
    pub fn value(&self) -> String {
        self.format(self.value)
    }

    /// Formats the value with its sign.
    pub fn signed(&self) -> String {
        with_plus_sign(self.value())
    }

    /// Formats both ends of the interval: `0.0179 – 0.0187`, `−1.54 to −1.35`.
    pub fn interval(&self) -> String {
        join_ends(self.ends())
    }

    /// Formats both ends of the interval with their signs: `−0.65 to +0.63`.
    pub fn signed_interval(&self) -> String {
        join_ends(self.ends().map(with_plus_sign))
    }

    fn ends(&self) -> [String; 2] {
        [self.interval.0, self.interval.1].map(|end| self.format(end))
    }

    /// Formats a number. If the interval excludes zero, a number other than zero keeps at least one significant
    /// digit, so that the number is not shown as zero.
    fn format(&self, value: f64) -> String {
        let excludes_zero = self.interval.0 > 0.0 || self.interval.1 < 0.0;
        // Number of decimals up to the first significant digit.
        let min_decimals = if excludes_zero && value != 0.0 { -value.abs().log10().floor() } else { 0.0 };
        let text = fixed(value, self.decimals);
        if min_decimals > 0.0 && !has_nonzero_digit(&text) {
            fixed(value, min_decimals as usize)
        } else {
            text
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn estimate(value: f64, lo: f64, hi: f64) -> Estimate {
        Estimate::new(value / 1e3, (lo / 1e3, hi / 1e3))
    }

    #[test]
    fn digits_follow_interval_of_any_width() {
        let text = |it: Estimate| format!("{} ({})", it.value(), it.interval());
        assert_eq!(text(estimate(0.002_013, 0.001_98, 0.002_05)), "0.002013 (0.001980 – 0.002050)");
        assert_eq!(text(estimate(0.018_31, 0.017_9, 0.018_7)), "0.01831 (0.01790 – 0.01870)");
        assert_eq!(text(estimate(6.304, 5.66, 6.93)), "6.30 (5.66 – 6.93)");
        assert_eq!(text(estimate(270.4, 250.0, 290.0)), "270 (250 – 290)");
        assert_eq!(text(estimate(270.4, 250.0, 290.0).with_decimals(1)), "270.4 (250.0 – 290.0)");
        assert_eq!(text(estimate(0.000_3, 0.000_3, 0.000_3)), "0.000300 (0.000300)");
        assert_eq!(text(estimate(0.0, 0.0, 0.0)), "0.00 (0.00)");
    }

    #[test]
    fn significant_difference_is_not_shown_as_zero() {
        let text = |it: Estimate| format!("{}, {}", it.signed(), it.signed_interval());
        assert_eq!(
            text(estimate(-0.000_7, -0.001_2, -0.000_2)),
            "\u{2212}0.00070, \u{2212}0.00120 to \u{2212}0.00020"
        );
        assert_eq!(text(estimate(0.25, 0.000_000_21, 0.5)), "+0.25, +0.0000002 to +0.50");
        assert_eq!(
            text(estimate(0.25, -0.000_000_21, 0.5)),
            "+0.25, 0.00 to +0.50",
            "zero is in the interval, so an end may be shown as zero"
        );
        assert_eq!(text(estimate(-1.4, -1.54, -1.35)), "\u{2212}1.400, \u{2212}1.540 to \u{2212}1.350");
    }

    proptest! {
        #[test]
        fn different_ends_are_distinct_after_rounding(
            lo_exponent in -9f64..3.0, width_exponent in -6f64..6.0, is_negative in any::<bool>()
        ) {
            let lo = 10f64.powf(lo_exponent);
            let hi = lo * (1.0 + 10f64.powf(width_exponent));
            let (lo, hi) = if is_negative { (-hi, -lo) } else { (lo, hi) };
            let found = estimate(f64::midpoint(lo, hi), lo, hi);
            let [from, to] = found.ends();
            prop_assert!(has_nonzero_digit(&from) && has_nonzero_digit(&to) && has_nonzero_digit(&found.value()), "{found:?}");
            // At most nine decimals are shown, so closer ends may be equal after rounding.
            prop_assert!(from != to || hi - lo < 1e-8, "{from} {to}");
        }
    }
}
