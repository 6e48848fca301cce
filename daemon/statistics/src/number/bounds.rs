//! Formatting of numbers whose bounds follow from clocks, in ms. They have as many digits as the bound supports, but no
//! digit below a microsecond, because the clock of another host is never known more precisely.

use super::milliseconds::default_decimals;
use super::{EXACT, SPACE, decimals, fixed, fixed_or_less_than, join_ends, milliseconds, signed};

/// Number of decimals for a resolution of a microsecond.
const MAX_DECIMALS: usize = 3;

/// Returns the number of decimals of a value in ms whose error is known: down to the second significant digit of the
/// error. If the error is zero, the number of decimals follows from the size of the value.
fn decimals_within(seconds: f64, half_width: f64) -> usize {
    if half_width > 0.0 {
        decimals(half_width * 1e3, 2).min(MAX_DECIMALS)
    } else {
        default_decimals(seconds * 1e3)
    }
}

/// Returns whether an interval of this width, or half width, is that of an exact delay: one clock stamped both ends of
/// the message.
// The relation of two clocks always has an error, so an interval without width needs no relation. The width is tested
// and not the source of the delay, because stored statistics have no sources.
pub fn is_exact(width: f64) -> bool {
    width == 0.0
}

/// Formats the largest error of a value: `±0.65`, `±0.006`, or `exact` for zero.
pub fn bound_ms(half_width: f64) -> String {
    if is_exact(half_width) {
        return EXACT.to_owned();
    }
    format!("±{}", fixed_or_less_than(half_width * 1e3, decimals(half_width * 1e3, 2).min(MAX_DECIMALS)))
}

/// Formats the largest error of a value with its unit: `±0.65 ms`, `exact`.
pub fn bound(half_width: f64) -> String {
    let unit = if is_exact(half_width) { String::new() } else { format!("{SPACE}ms") };
    format!("{}{unit}", bound_ms(half_width))
}

/// Formats both ends of an interval in ms, with the digits that the width of the interval supports.
pub fn ends_ms(lo: f64, hi: f64) -> [String; 2] {
    let decimals = decimals_within(hi, (hi - lo) / 2.0);
    [lo, hi].map(|end| fixed(end * 1e3, decimals))
}

/// Formats an interval, with more digits if it is narrow: `5.66 – 6.93`, `0.394 – 0.405`, `−1.54 to −1.35`. Equal
/// ends give one number.
pub fn interval_ms(lo: f64, hi: f64) -> String {
    if lo == hi { milliseconds(lo) } else { join_ends(ends_ms(lo, hi)) }
}

/// Formats a value within an interval in ms, with the digits that the width of the interval supports: `0.043`, `6.3`.
pub fn within_ms(seconds: f64, (lo, hi): (f64, f64)) -> String {
    fixed(seconds * 1e3, decimals_within(seconds, (hi - lo) / 2.0))
}

/// Formats a difference in ms with its sign and the digits that the width of its interval supports: `−1.45`.
pub fn signed_within_ms(seconds: f64, (lo, hi): (f64, f64)) -> String {
    signed(seconds * 1e3, decimals_within(seconds, (hi - lo) / 2.0))
}

/// Formats an interval of a change: `−0.65 to +0.63`.
pub fn shift_ms(lo: f64, hi: f64) -> String {
    let decimals = decimals_within(hi, (hi - lo) / 2.0);
    join_ends([lo, hi].map(|end| signed(end * 1e3, decimals)))
}

/// Formats a clock offset with its sign and the digits that its bound supports: `+1,204.18`, `−1,002.698`, `+250`.
/// If the bound is zero, there are two decimals.
pub fn offset_ms(seconds: f64, half_width: f64) -> String {
    signed(seconds * 1e3, if half_width > 0.0 { decimals_within(seconds, half_width) } else { 2 })
}
