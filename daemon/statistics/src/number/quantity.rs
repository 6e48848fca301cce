//! Formatting of shares, rates and sizes.

use std::fmt;

use super::{BITS_PER_MB, SPACE, decimals, fixed, fixed_or_less_than, significant};

/// Maximum number of decimals of a throughput in MB/s. The sixth decimal is one byte per second.
const MAX_DECIMALS: usize = 6;

/// Number and unit, kept apart because a page formats them differently.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Quantity {
    /// The digits.
    pub number: String,
    /// Symbol of the unit.
    pub unit: &'static str,
}

impl Quantity {
    pub(super) fn new(number: String, unit: &'static str) -> Self {
        Self { number, unit }
    }

    /// Returns the text for a terminal or a file, with an ordinary space: `26.2 kB`.
    pub fn plain(&self) -> String {
        format!("{} {}", self.number, self.unit)
    }
}

/// Formats the quantity for a page, with a narrow space.
impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{SPACE}{}", self.number, self.unit)
    }
}

/// Formats a share in percent, without the percent sign: `0`, `<0.01`, `0.02`, `1.3`, `14`.
pub fn percent(share: f64) -> String {
    let value = share * 100.0;
    match value {
        // From each limit on, the number would be rounded up to a number with one more digit: `1.00`, `10.0`.
        value if value < 0.995 => fixed_or_less_than(value, 2),
        value if value < 9.95 => fixed(value, 1),
        value => fixed(value, 0),
    }
}

/// Formats a share of a whole in percent with one decimal: `29.0`.
pub fn share(share: f64) -> String {
    fixed_or_less_than(share * 100.0, 1)
}

/// Formats a load, such as that of a processor, in whole percent: `29`.
pub fn whole_percent(share: f64) -> String {
    fixed(share * 100.0, 0)
}

/// Formats a rate per second: below 10 with three significant digits, below 1,000 with one decimal, above without
/// decimals: `0`, `0.0137`, `5.00`, `141.3`, `12,346`.
pub fn rate(hz: f64) -> String {
    match hz {
        0.0 => "0".to_owned(),
        // As in `percent`, the limits are where rounding would add a digit.
        hz if hz < 9.995 => significant(hz),
        hz if hz < 999.95 => fixed(hz, 1),
        hz => fixed(hz, 0),
    }
}

/// Formats bits per second in MB/s with three significant digits: `0.00625`, `0.690`, `106`.
pub fn throughput(bits_per_second: f64) -> String {
    let value = bits_per_second / BITS_PER_MB;
    if value == 0.0 { "0".to_owned() } else { fixed(value, decimals(value, 3).min(MAX_DECIMALS)) }
}

/// Formats bits per second and their margin in MB/s, both down to the second significant digit of the margin: `943 ±
/// 14`.
pub fn throughput_with_margin(bits_per_second: f64, margin: f64) -> String {
    let [rate, margin] = [bits_per_second, margin].map(|bits| bits / BITS_PER_MB);
    let decimals = if margin > 0.0 { decimals(margin, 2) } else { decimals(rate, 3) }.min(MAX_DECIMALS);
    format!("{} ± {}", fixed(rate, decimals), fixed(margin, decimals))
}

/// Formats an interval of bits per second in MB/s, down to the second significant digit of half its width: `930 – 957`.
/// If the upper end is missing or infinite, only the lower end is shown: `≥ 1.00`.
pub fn throughput_between((lo, hi): (f64, Option<f64>)) -> String {
    let Some(hi) = hi.filter(|hi| hi.is_finite()) else { return format!("≥ {}", throughput(lo)) };
    if lo == hi {
        return throughput(lo);
    }
    let decimals = decimals((hi - lo) / 2.0 / BITS_PER_MB, 2).min(MAX_DECIMALS);
    super::join_ends([lo, hi].map(|end| fixed(end / BITS_PER_MB, decimals)))
}

/// Formats a size in the largest decimal unit in which the number is at least 1: `412 B`, `151 kB`, `1.2 MB`. Zeros at
/// the end of the decimals are left out. Bytes are counted exactly, so these zeros would say nothing about precision.
pub fn bytes(value: f64) -> Quantity {
    const UNITS: [&str; 5] = ["B", "kB", "MB", "GB", "TB"];
    if value < 999.5 {
        return Quantity::new(fixed(value, 0), "B");
    }
    let mut value = value;
    let mut unit = 0;
    // From 999.5 on, three significant digits would be rounded to `1,000`.
    while value >= 999.5 && unit + 1 < UNITS.len() {
        value /= 1e3;
        unit += 1;
    }
    let text = significant(value);
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    Quantity::new(text.to_owned(), UNITS[unit])
}

/// Formats bytes in gigabytes with one decimal: `5.2`.
pub fn gigabytes(bytes: u64) -> String {
    fixed_or_less_than(bytes as f64 / 1e9, 1)
}

/// Formats a ratio: `1.9 ×`.
pub fn times(ratio: f64) -> String {
    let text = match ratio.abs() {
        size if size < 0.995 => fixed(ratio, 2),
        size if size < 99.5 => fixed(ratio, 1),
        _ => fixed(ratio, 0),
    };
    format!("{text}{SPACE}×")
}
