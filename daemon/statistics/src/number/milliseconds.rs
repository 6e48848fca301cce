//! Durations, in ms wherever they are compared.

use super::{Quantity, between, decimals, figure, fixed, measured, signed};

/// Most decimals of a figure in ms: a nanosecond.
const MOST: usize = 6;
/// Decimals of a tenth of a microsecond.
const TENTH_OF_MICROSECOND: usize = 4;
/// Below so many ms there is nothing that a clock could tell from zero.
const NOTHING: f64 = 1e-6;

/// Below so many ms two decimals are one digit.
const SHORT: f64 = 0.099_95;

/// Decimals of a column of figures that have a bound or deviation.
const LEAST_IN_COLUMN: usize = 2;
const MOST_IN_COLUMN: usize = 3;

/// The decimals of a number of ms that has no interval: three significant digits, to the nanosecond.
pub(super) fn own_decimals(ms: f64) -> usize {
    if ms.abs() < NOTHING { 2 } else { decimals(ms, 3).min(MOST) }
}

/// Seconds in ms with three significant digits: `0.126`, `6.31`, `16.1`, `141`.
pub fn milliseconds(seconds: f64) -> String {
    fixed(seconds * 1e3, own_decimals(seconds * 1e3))
}

/// A duration in a sentence or figure: in ms, from 1,000 ms on in s.
pub fn duration(seconds: f64) -> Quantity {
    if seconds.abs() < 0.999_5 { short_duration(seconds) } else { Quantity::new(figure(seconds), "s") }
}

/// A duration in a figure that is always in ms. What two decimals would leave with one digit has three: `0.0183 ms`.
pub fn short_duration(seconds: f64) -> Quantity {
    let ms = seconds * 1e3;
    let text = if ms.abs() < SHORT { milliseconds(seconds) } else { figure(ms) };
    Quantity::new(text, "ms")
}

/// A stage's duration in a table, in ms with two decimals; what would round to nothing is `<0.01`.
pub fn stage_ms(seconds: f64) -> String {
    measured(seconds * 1e3, 2)
}

/// A total on a live page, in ms with one decimal.
pub fn total_ms(seconds: f64) -> String {
    measured(seconds * 1e3, 1)
}

/// A difference of durations in ms: `+0.03`, `−0.02`; zero has no sign.
pub fn difference_ms(seconds: f64) -> String {
    signed(seconds * 1e3, 2)
}

/// Mean and deviation, or value and margin, in ms, `16.2` and `1.1`: the last digit of both is the second one of the
/// deviation, to a tenth of a microsecond, and finer where the value itself is shorter. Without a deviation a value has
/// three digits.
pub fn mean_std_ms(mean: f64, std: Option<f64>) -> (String, Option<String>) {
    let std = std.filter(|std| std.is_finite());
    let decimals = match std {
        Some(std) if std > 0.0 => {
            decimals(std * 1e3, 2).min(own_decimals(mean * 1e3).max(TENTH_OF_MICROSECOND))
        }
        _ => own_decimals(mean * 1e3),
    };
    (fixed(mean * 1e3, decimals), std.map(|std| fixed(std * 1e3, decimals)))
}

/// The same in one text: `16.2 ± 1.1`.
pub fn mean_std(mean: f64, std: Option<f64>) -> String {
    match mean_std_ms(mean, std) {
        (mean, Some(std)) => format!("{mean} ± {std}"),
        (mean, None) => mean,
    }
}

/// An interval of what was measured, in ms, to the second digit of its half width: `0.0418 – 0.0561`, `−1.54 to −1.35`. One
/// figure where the ends are the same.
pub fn range_ms((lo, hi): (f64, f64)) -> String {
    if lo == hi {
        return milliseconds(lo);
    }
    let decimals = decimals((hi - lo) / 2.0 * 1e3, 2).min(TENTH_OF_MICROSECOND);
    between([lo, hi].map(|end| fixed(end * 1e3, decimals)))
}

/// The decimals of a column of ms of whose figures is known how far they can be off: two, or three where the half width
/// has its second digit there. All figures of a stage have as many, so that they compare.
pub fn column_decimals(half_width: Option<f64>) -> usize {
    match half_width {
        None => LEAST_IN_COLUMN,
        // Exact: as fine as it is measured.
        Some(0.0) => MOST_IN_COLUMN,
        Some(half_width) => decimals(half_width * 1e3, 2).clamp(LEAST_IN_COLUMN, MOST_IN_COLUMN),
    }
}

/// A round trip in ms: as any figure, and to the microsecond where it is short: `1.30`, `0.018`.
pub fn trip_ms(seconds: f64) -> String {
    let ms = seconds * 1e3;
    measured(ms, if ms.abs() < 0.095 { 3 } else { decimals(ms, 3).min(2) })
}

/// An error in seconds, in ms with two significant digits.
pub fn error_ms(seconds: f64) -> String {
    fixed(seconds * 1e3, decimals(seconds * 1e3, 2).min(MOST))
}
