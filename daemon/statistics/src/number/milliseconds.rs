//! Formatting of durations: in ms, or in s for a single long duration.

use super::{Quantity, decimals, figure, fixed, fixed_or_less_than, join_ends, signed};

/// Maximum number of decimals of a value in ms. The sixth decimal is one nanosecond.
const MAX_DECIMALS: usize = 6;
/// Number of decimals of a value in ms that resolve a tenth of a microsecond.
const TENTH_OF_MICROSECOND: usize = 4;
/// Shortest duration that a clock distinguishes from zero: a nanosecond.
const MIN_DISTINGUISHABLE_MS: f64 = 1e-6;

/// Duration below which two decimals of a millisecond would show only one significant digit.
// The limit is not 0.1: from this limit on, three significant digits are rounded to at least `0.100`.
const SHORT_DURATION_MS: f64 = 0.099_95;

/// Smallest number of decimals in a column of values with a bound or deviation.
const MIN_COLUMN_DECIMALS: usize = 2;
/// Maximum number of decimals in a column of values with a bound or deviation.
const MAX_COLUMN_DECIMALS: usize = 3;

/// Returns the number of decimals of a value in ms without an interval: three significant digits, at most to the
/// nanosecond.
pub(super) fn default_decimals(ms: f64) -> usize {
    if ms.abs() < MIN_DISTINGUISHABLE_MS { 2 } else { decimals(ms, 3).min(MAX_DECIMALS) }
}

/// Formats seconds in ms with three significant digits: `0.126`, `6.31`, `16.1`, `141`.
pub fn milliseconds(seconds: f64) -> String {
    fixed(seconds * 1e3, default_decimals(seconds * 1e3))
}

/// Formats a duration with its unit: in ms, or in s if it is 1,000 ms or more.
pub fn duration(seconds: f64) -> Quantity {
    // From 0.9995 s on, the number of milliseconds would be rounded to `1,000`.
    if seconds.abs() < 0.999_5 {
        Quantity::new(milliseconds(seconds), "ms")
    } else {
        Quantity::new(figure(seconds), "s")
    }
}

/// Format of all durations of one table, in ms. Their number of decimals follows from the total of the table. If the
/// total is below 0.1 ms, the total has three significant digits. Otherwise there are two decimals, or three if the
/// deviation of the total needs a third decimal for two significant digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DurationFormat {
    decimals: usize,
}

impl Default for DurationFormat {
    fn default() -> Self {
        Self { decimals: MIN_COLUMN_DECIMALS }
    }
}

impl DurationFormat {
    /// Returns the format for a table whose total has this mean and deviation.
    pub fn for_total(mean: Option<f64>, std: Option<f64>) -> Self {
        let short = mean.map(|seconds| seconds * 1e3).filter(|ms| ms.abs() < SHORT_DURATION_MS);
        Self {
            decimals: short
                .map_or_else(|| decimals_for_error(std.filter(|std| *std > 0.0)), default_decimals),
        }
    }

    /// Formats a duration; a value that would be rounded to zero is `<0.01`.
    pub fn duration(self, seconds: f64) -> String {
        fixed_ms(seconds, self.decimals)
    }

    /// Formats a time, or a deviation, that may be zero or negative.
    pub fn number(self, seconds: f64) -> String {
        fixed(seconds * 1e3, self.decimals)
    }

    /// Formats a difference: `+0.03`, `−0.02`; zero has no sign.
    pub fn difference(self, seconds: f64) -> String {
        signed(seconds * 1e3, self.decimals)
    }
}

/// Formats a total for a live page, in ms with one decimal; below 1 ms with three significant digits.
pub fn total_ms(seconds: f64) -> String {
    let ms = seconds * 1e3;
    // From 0.9995 ms on, three significant digits are rounded to at least `1.00`.
    fixed_or_less_than(ms, if ms.abs() < 0.999_5 { default_decimals(ms) } else { 1 })
}

/// Formats mean and deviation, or value and margin, in ms: `16.2` and `1.1`.
///
/// Both numbers have the same number of decimals: down to the second significant digit of the deviation. The limit is
/// four decimals (a tenth of a microsecond), or the decimals for three significant digits of the mean if these are
/// more. Without a deviation, the mean has three significant digits.
pub fn mean_std_ms(mean: f64, std: Option<f64>) -> (String, Option<String>) {
    let std = std.filter(|std| std.is_finite());
    let decimals = match std {
        Some(std) if std > 0.0 => {
            decimals(std * 1e3, 2).min(default_decimals(mean * 1e3).max(TENTH_OF_MICROSECOND))
        }
        _ => default_decimals(mean * 1e3),
    };
    (fixed(mean * 1e3, decimals), std.map(|std| fixed(std * 1e3, decimals)))
}

/// Formats mean and deviation as one text: `16.2 ± 1.1`.
pub fn mean_std(mean: f64, std: Option<f64>) -> String {
    join_mean_std(mean_std_ms(mean, std))
}

/// Formats a duration in ms with this number of decimals; a value that would be rounded to zero is `<0.01`.
pub fn fixed_ms(seconds: f64, decimals: usize) -> String {
    fixed_or_less_than(seconds * 1e3, decimals)
}

/// Formats mean and deviation in ms, both with this number of decimals: `<0.01` and `0.50`.
pub fn fixed_mean_std_ms(mean: f64, std: Option<f64>, decimals: usize) -> (String, Option<String>) {
    (fixed_ms(mean, decimals), std.map(|std| fixed(std * 1e3, decimals)))
}

/// Joins the texts of mean and deviation: `16.2 ± 1.1`.
pub fn join_mean_std((mean, std): (String, Option<String>)) -> String {
    match std {
        Some(std) => format!("{mean} ± {std}"),
        None => mean,
    }
}

/// Formats an interval of measured values in ms: `0.0418 – 0.0561`, `−1.54 to −1.35`. Both ends have as many decimals
/// as half the interval's width needs for two significant digits. If the ends are equal, one number is returned.
pub fn range_ms((lo, hi): (f64, f64)) -> String {
    if lo == hi {
        return milliseconds(lo);
    }
    let decimals = decimals((hi - lo) / 2.0 * 1e3, 2).min(TENTH_OF_MICROSECOND);
    join_ends([lo, hi].map(|end| fixed(end * 1e3, decimals)))
}

/// Returns the number of decimals of a column in ms whose values have these errors: three if an error needs so many for
/// two significant digits, otherwise two. All values of a column have the same number of decimals, so that they can be
/// compared. Without values the number is 0.
pub fn column_decimals(half_widths: impl IntoIterator<Item = Option<f64>>) -> usize {
    half_widths.into_iter().map(decimals_for_error).max().unwrap_or_default()
}

/// Returns the number of decimals for a value with this error, within the limits of a column.
fn decimals_for_error(half_width: Option<f64>) -> usize {
    match half_width {
        None => MIN_COLUMN_DECIMALS,
        // Exact values are shown as precisely as they are measured.
        Some(0.0) => MAX_COLUMN_DECIMALS,
        Some(half_width) => decimals(half_width * 1e3, 2).clamp(MIN_COLUMN_DECIMALS, MAX_COLUMN_DECIMALS),
    }
}

/// Formats a round trip in ms with three significant digits, but at most two decimals: `1.30`. A round trip below 0.095
/// ms has three decimals: `0.018`.
pub fn trip_ms(seconds: f64) -> String {
    let ms = seconds * 1e3;
    // From 0.095 ms on, two decimals are rounded to at least `0.10`.
    fixed_or_less_than(ms, if ms.abs() < 0.095 { 3 } else { decimals(ms, 3).min(2) })
}

/// Formats an error in seconds, in ms with two significant digits.
pub fn error_ms(seconds: f64) -> String {
    fixed(seconds * 1e3, decimals(seconds * 1e3, 2).min(MAX_DECIMALS))
}
