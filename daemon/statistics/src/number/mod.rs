//! Formatting of numbers for people, so that a value looks the same on every page, in every table and in every
//! program.
//!
//! Values are given in SI base units, as they are stored. The result is text without the unit, which is in the
//! column's name or beside the number ([`Quantity`]). The dashboard's script follows the same rules;
//! `tests/numbers.json` has test cases for both.

mod bounds;
mod estimate;
mod long_duration;
mod milliseconds;
mod quantity;
#[cfg(test)]
mod tests;

pub use bounds::{
    bound, bound_ms, ends_ms, interval_ms, is_exact, offset_ms, shift_ms, signed_within_ms, within_ms,
};
pub use estimate::Estimate;
pub use long_duration::{estimated_duration, long_duration};
pub use milliseconds::{
    DurationFormat, column_decimals, duration, error_ms, fixed_mean_std_ms, fixed_ms, join_mean_std,
    mean_std, mean_std_ms, milliseconds, range_ms, total_ms, trip_ms,
};
pub use quantity::{
    Quantity, bytes, gigabytes, percent, rate, share, throughput, throughput_between, throughput_with_margin,
    times, whole_percent,
};

/// Number of bits in a megabyte. Throughputs are computed in bits per second and shown in MB/s.
pub const BITS_PER_MB: f64 = 8e6;
/// Text for a number that is absent or unknown.
pub const NONE: &str = "—";
/// Narrow no-break space between a number and its unit on a page.
pub const SPACE: &str = "\u{202f}";
/// Text for an uncertainty of exactly zero.
pub const EXACT: &str = "exact";

/// Maximum number of texts in a list.
const MAX_LISTED: usize = 8;

const MINUS: &str = "\u{2212}";

/// Magnitude from which numbers are written with their power of ten.
// More than twelve digits before the point are hard to read.
const EXPONENT_FROM: f64 = 1e12;
/// Magnitude below which numbers are written with their power of ten if [`MAX_DECIMALS`] decimals were requested.
const EXPONENT_BELOW: f64 = 1e-12;
/// Maximum number of decimals of a formatted number.
const MAX_DECIMALS: usize = 17;

/// Formats a number with a fixed number of decimals: with a true minus sign, commas between thousands, and no signed
/// zero.
///
/// Numbers of 10¹² or more have four significant digits and the power of ten: `−1.234e300`. So do numbers below 10⁻¹²
/// if 17 or more decimals are requested. A number that is not finite gives [`NONE`].
pub fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return NONE.to_owned();
    }
    let decimals = decimals.min(MAX_DECIMALS);
    let magnitude = value.abs();
    let is_tiny = value != 0.0 && magnitude < EXPONENT_BELOW && decimals == MAX_DECIMALS;
    if magnitude >= EXPONENT_FROM || is_tiny {
        let sign = if value < 0.0 { MINUS } else { "" };
        return format!("{sign}{magnitude:.3e}");
    }
    let digits = format!("{magnitude:.decimals$}");
    let (whole, fraction) = digits.split_once('.').unwrap_or((&digits, ""));
    // A number that is rounded to zero has no sign.
    let sign = if value < 0.0 && has_nonzero_digit(&digits) { MINUS } else { "" };
    let point = if fraction.is_empty() { "" } else { "." };
    format!("{sign}{}{point}{fraction}", group(whole))
}

/// Inserts commas between thousands.
fn group(digits: &str) -> String {
    let mut grouped = String::with_capacity(digits.len() * 4 / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped
}

/// Formats a count: `17,640`.
pub fn count(value: u64) -> String {
    group(&value.to_string())
}

/// Formats several counts: `44`, or `10 to 110` if they differ; `None` without counts.
pub fn range_of_counts(counts: impl Iterator<Item = u64> + Clone) -> Option<String> {
    let [fewest, most] = [counts.clone().min()?, counts.max()?].map(count);
    Some(if fewest == most { most } else { format!("{fewest} to {most}") })
}

/// Formats a count with its noun: `1 iteration`, `2,000 iterations`.
pub fn counted(value: u64, noun: &str) -> String {
    counted_with_plural(value, noun, &format!("{noun}s"))
}

/// Formats a count with its noun, whose plural does not end with `s` alone: `1 latency`, `2,000 latencies`.
pub fn counted_with_plural(value: u64, singular: &str, plural: &str) -> String {
    format!("{} {}", count(value), if value == 1 { singular } else { plural })
}

/// Lists the first texts and the number of the others: `001, 002 and 12 more`.
pub fn list_first(texts: &[String]) -> String {
    let listed = texts[..texts.len().min(MAX_LISTED)].join(", ");
    match texts.len().saturating_sub(MAX_LISTED) {
        0 => listed,
        others => format!("{listed} and {} more", count(others as u64)),
    }
}

/// Returns the number of decimals with which `value` has `digits` significant digits.
pub fn decimals(value: f64, digits: usize) -> usize {
    let digits_after_first = digits.saturating_sub(1);
    if value == 0.0 || !value.is_finite() {
        return digits_after_first;
    }
    // The value is rounded first, because rounding may carry into the next place: 0.09996 has three digits as 0.100.
    let rounded = format!("{value:.digits_after_first$e}");
    let power: i32 = rounded.split_once('e').and_then(|(_, power)| power.parse().ok()).unwrap_or_default();
    usize::try_from(digits_after_first as i32 - power).unwrap_or_default()
}

/// Formats a number with three significant digits, however small it is: `0.00631`, `0.620`, `16.1`, `1,243`.
pub fn significant(value: f64) -> String {
    fixed(value, decimals(value, 3))
}

/// Formats a number with three significant digits, but at most two decimals: `0.62`, `6.31`, `16.1`, `141`.
pub fn figure(value: f64) -> String {
    fixed(value, decimals(value, 3).min(2))
}

/// Formats a measured number that is not negative: `0` is exactly zero, `<0.01` is a small number.
pub fn fixed_or_less_than(value: f64, decimals: usize) -> String {
    let smallest = 10f64.powi(-(decimals as i32));
    if value == 0.0 {
        "0".to_owned()
    } else if value > 0.0 && value < smallest / 2.0 {
        format!("<{smallest:.decimals$}")
    } else {
        fixed(value, decimals)
    }
}

/// Formats a number with a plus or minus sign. A number that is rounded to zero has no sign.
pub fn signed(value: f64, decimals: usize) -> String {
    with_plus_sign(fixed(value, decimals))
}

fn with_plus_sign(text: String) -> String {
    if !text.starts_with(MINUS) && has_nonzero_digit(&text) { format!("+{text}") } else { text }
}

/// Returns whether a formatted number has a digit other than zero.
fn has_nonzero_digit(text: &str) -> bool {
    text.bytes().any(|digit| (b'1'..=b'9').contains(&digit))
}

/// Joins both ends of an interval by a dash. If an end has a sign, the ends are joined by the word `to`, because a dash
/// before a sign is hard to read. Equal ends give one number.
pub fn join_ends([lo, hi]: [String; 2]) -> String {
    let has_sign = |end: &str| end.starts_with(['\u{2212}', '+']);
    match (lo == hi, has_sign(&lo) || has_sign(&hi)) {
        (true, _) => lo,
        (false, true) => format!("{lo} to {hi}"),
        (false, false) => format!("{lo} – {hi}"),
    }
}
