//! Numbers as people read them: one place, so that a figure looks the same on every page.
//!
//! Values come in SI base units, as they are stored, and leave as text. The unit is kept apart
//! ([`Quantity`]) because a page sets it quieter than its number.

mod estimate;

use std::fmt;

pub(crate) use estimate::Estimate;

/// What stands where a number does not exist or is not known.
pub(crate) const NONE: &str = "—";
/// Between a number and its unit: a narrow space at which no line breaks.
pub(crate) const SPACE: &str = "\u{202f}";
const MINUS: &str = "\u{2212}";
/// Below so many ms two decimals are one digit.
const SHORT: f64 = 0.099_95;
/// What stands where a bound would, if there is nothing to bound.
pub(crate) const EXACT: &str = "exact";

/// A number and its unit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Quantity {
    /// The digits.
    pub number: String,
    /// The unit's symbol.
    pub unit: &'static str,
}

impl Quantity {
    fn new(number: String, unit: &'static str) -> Self {
        Self { number, unit }
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{SPACE}{}", self.number, self.unit)
    }
}

/// A number with a fixed count of decimals, thousands parted by commas; zero has no sign.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return NONE.to_owned();
    }
    let digits = format!("{:.decimals$}", value.abs());
    let (whole, fraction) = digits.split_once('.').unwrap_or((&digits, ""));
    let sign =
        if value < 0.0 && digits.bytes().any(|digit| (b'1'..=b'9').contains(&digit)) { MINUS } else { "" };
    let point = if fraction.is_empty() { "" } else { "." };
    format!("{sign}{}{point}{fraction}", group(whole))
}

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

/// A count: `17,640`.
pub(crate) fn count(value: u64) -> String {
    group(&value.to_string())
}

/// The decimals at which a number has three significant digits, but never more than two.
fn decimals_of(value: f64) -> usize {
    match value.abs() {
        size if size < 9.995 => 2,
        size if size < 99.95 => 1,
        _ => 0,
    }
}

/// The decimals at which a number has three significant digits, however small: not more than six.
fn decimals_significant(value: f64) -> usize {
    let size = value.abs();
    if !(1e-6..1.0).contains(&size) {
        decimals_of(value)
    } else {
        // What is rounded to the next power of ten has that one's digits.
        (2 - (size / 0.999_5).log10().floor() as i32).clamp(2, 6) as usize
    }
}

/// A stored duration in a list, in ms with three significant digits: `0.126`, `6.31`, `16.1`, `141`.
pub(crate) fn listed_ms(seconds: f64) -> String {
    fixed(seconds * 1e3, decimals_significant(seconds * 1e3))
}

/// A number in a sentence or figure: `0.62`, `6.31`, `16.1`, `141`.
pub(crate) fn figure(value: f64) -> String {
    fixed(value, decimals_of(value))
}

/// A duration in a sentence or figure: in ms, from 1,000 ms on in s.
pub(crate) fn duration(seconds: f64) -> Quantity {
    if seconds.abs() < 0.999_5 { milliseconds(seconds) } else { Quantity::new(figure(seconds), "s") }
}

/// A duration in a figure that is always in ms. What two decimals would leave with one digit has three: `0.0183 ms`.
pub(crate) fn milliseconds(seconds: f64) -> Quantity {
    let value = seconds * 1e3;
    let decimals = if value.abs() < SHORT { decimals_significant(value) } else { decimals_of(value) };
    Quantity::new(fixed(value, decimals), "ms")
}

/// A stage's duration in a table, in ms with two decimals; what would round to nothing is `<0.01`.
pub(crate) fn stage_ms(seconds: f64) -> String {
    measured(seconds * 1e3, 2)
}

/// A total on a live page, in ms with one decimal.
pub(crate) fn total_ms(seconds: f64) -> String {
    measured(seconds * 1e3, 1)
}

/// A measured number that is not negative: `0` is exactly zero, `<0.01` is small.
pub(crate) fn measured(value: f64, decimals: usize) -> String {
    let smallest = 10f64.powi(-(decimals as i32));
    if value == 0.0 {
        "0".to_owned()
    } else if value > 0.0 && value < smallest / 2.0 {
        format!("<{smallest:.decimals$}")
    } else {
        fixed(value, decimals)
    }
}

/// With a plus where it is more than zero as shown.
fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    let positive = value > 0.0 && text.bytes().any(|digit| (b'1'..=b'9').contains(&digit));
    if positive { format!("+{text}") } else { text }
}

/// A difference of durations in ms: `+0.03`, `−0.02`; zero has no sign.
pub(crate) fn difference_ms(seconds: f64) -> String {
    signed(seconds * 1e3, 2)
}

/// The decimals, at most so many, at which the last digit of a value stands where its bound has its second digit.
fn decimals_supported(bound: f64, most: usize) -> usize {
    if bound <= 0.0 || !bound.is_finite() {
        return 2;
    }
    (1 - bound.log10().floor() as i32).clamp(0, most as i32) as usize
}

/// Mean and deviation in ms, `16.2 ± 1.1`, with the digits that the deviation supports: of what is shorter than a
/// millisecond too (`0.126 ± 0.012`), to the nanosecond.
pub(crate) fn mean_std_ms(mean: f64, std: Option<f64>) -> (String, Option<String>) {
    let supported = std.filter(|std| *std > 0.0).map(|std| decimals_supported(std * 1e3, 6));
    let decimals = decimals_significant(mean * 1e3);
    let decimals = supported.map_or(decimals, |supported| supported.min(decimals));
    (fixed(mean * 1e3, decimals), std.map(|std| fixed(std * 1e3, decimals)))
}

/// The decimals of a value in ms whose bound is known: as far as the bound's second digit, but not below a microsecond.
/// An exact one has those of its own size.
fn decimals_within(value: f64, half_width: f64) -> usize {
    if half_width > 0.0 { decimals_supported(half_width * 1e3, 3) } else { decimals_of_trip(value * 1e3) }
}

/// A clock bound in ms, to the microsecond: `±0.65`, `±0.006`; nothing at all is `exact`.
pub(crate) fn bound_ms(half_width: f64) -> String {
    if half_width == 0.0 {
        return EXACT.to_owned();
    }
    format!("±{}", measured(half_width * 1e3, decimals_supported(half_width * 1e3, 3)))
}

/// The same with its unit: `±0.65 ms`, `exact`.
pub(crate) fn bound(half_width: f64) -> String {
    let unit = if half_width == 0.0 { String::new() } else { format!("{SPACE}ms") };
    format!("{}{unit}", bound_ms(half_width))
}

/// Both ends of an interval in ms, with the digits that its width supports.
pub(crate) fn ends_ms(lo: f64, hi: f64) -> [String; 2] {
    let decimals = decimals_within(hi, (hi - lo) / 2.0);
    [lo, hi].map(|end| fixed(end * 1e3, decimals))
}

/// An interval in ms, finer where it is narrow: `5.66 – 6.93`, `0.394 – 0.405`, `−1.54 to −1.35`.
pub(crate) fn interval_ms(lo: f64, hi: f64) -> String {
    let [lo, hi] = ends_ms(lo, hi);
    // A dash before a minus is hard to read.
    let between = if [&lo, &hi].into_iter().any(|end| end.starts_with(MINUS)) { "to" } else { "–" };
    format!("{lo} {between} {hi}")
}

/// A value in ms that lies within an interval, with the digits that its width supports: `0.043`, `6.3`.
pub(crate) fn within_ms(seconds: f64, (lo, hi): (f64, f64)) -> String {
    fixed(seconds * 1e3, decimals_within(seconds, (hi - lo) / 2.0))
}

/// A difference in ms with its sign, for a value that lies within an interval.
pub(crate) fn signed_within_ms(seconds: f64, (lo, hi): (f64, f64)) -> String {
    signed(seconds * 1e3, decimals_within(seconds, (hi - lo) / 2.0))
}

/// How far something may move, in ms: `−0.65 to +0.63`.
pub(crate) fn shift_ms(lo: f64, hi: f64) -> String {
    let decimals = decimals_within(hi, (hi - lo) / 2.0);
    format!("{} to {}", signed(lo * 1e3, decimals), signed(hi * 1e3, decimals))
}

/// A clock offset in ms with its sign and the digits that its bound supports: `+1,204.18`, `−1,002.698`, `+250`.
pub(crate) fn offset_ms(seconds: f64, half_width: f64) -> String {
    signed(seconds * 1e3, if half_width > 0.0 { decimals_within(seconds, half_width) } else { 2 })
}

/// A round trip in ms: as any figure, and to the microsecond where it is short: `1.30`, `0.018`.
pub(crate) fn trip_ms(seconds: f64) -> String {
    let value = seconds * 1e3;
    measured(value, decimals_of_trip(value))
}

fn decimals_of_trip(value: f64) -> usize {
    if value.abs() < 0.095 { 3 } else { decimals_of(value) }
}

/// A share in percent without its sign: `0`, `<0.01`, `0.02`, `1.3`, `14`.
pub(crate) fn percent(share: f64) -> String {
    let value = share * 100.0;
    match value {
        value if value < 0.995 => measured(value, 2),
        value if value < 9.95 => fixed(value, 1),
        value => fixed(value, 0),
    }
}

/// A share of a whole in percent with one decimal: `29.0`.
pub(crate) fn share(share: f64) -> String {
    measured(share * 100.0, 1)
}

/// Iterations per second.
pub(crate) fn rate(hz: f64) -> String {
    match hz {
        0.0 => "0".to_owned(),
        hz if hz < 9.995 => fixed(hz, 2),
        hz if hz < 999.95 => fixed(hz, 1),
        hz => fixed(hz, 0),
    }
}

/// A throughput in MB/s from bits per second.
pub(crate) fn throughput(bits_per_second: f64) -> String {
    let value = bits_per_second / 8e6;
    match value {
        value if value < 9.995 => measured(value, 2),
        value if value < 999.95 => fixed(value, 1),
        value => fixed(value, 0),
    }
}

/// A size in decimal units: `412 B`, `151 kB`, `1.23 MB`.
pub(crate) fn bytes(value: f64) -> Quantity {
    const UNITS: [&str; 5] = ["B", "kB", "MB", "GB", "TB"];
    if value < 999.5 {
        return Quantity::new(fixed(value, 0), "B");
    }
    let mut value = value;
    let mut unit = 0;
    while value >= 999.5 && unit + 1 < UNITS.len() {
        value /= 1e3;
        unit += 1;
    }
    Quantity::new(figure(value), UNITS[unit])
}

/// Gigabytes with one decimal: `5.2`.
pub(crate) fn gigabytes(bytes: u64) -> String {
    measured(bytes as f64 / 1e9, 1)
}

/// How many times: `1.9 ×`.
pub(crate) fn times(ratio: f64) -> String {
    let decimals = if ratio.abs() < 0.995 {
        2
    } else if ratio.abs() < 99.5 {
        1
    } else {
        0
    };
    format!("{}{SPACE}×", fixed(ratio, decimals))
}

/// A length of time in words: `0.4 s`, `35 s`, `4 min 12 s`, `2 h 5 min`, `3 d 4 h`.
pub(crate) fn length(seconds: f64) -> String {
    if !seconds.is_finite() || seconds < 0.0 {
        return NONE.to_owned();
    }
    if seconds < 9.95 {
        return format!("{}{SPACE}s", measured(seconds, 1));
    }
    let whole = seconds.round() as u64;
    let (days, hours, minutes, rest) = (whole / 86_400, whole / 3_600 % 24, whole / 60 % 60, whole % 60);
    let parts = match (days, hours, minutes) {
        (0, 0, 0) => vec![(rest, "s")],
        (0, 0, _) => vec![(minutes, "min"), (rest, "s")],
        (0, ..) => vec![(hours, "h"), (minutes, "min")],
        _ => vec![(days, "d"), (hours, "h")],
    };
    let shown = parts.iter().enumerate().filter(|(index, (value, _))| *index == 0 || *value > 0);
    shown.map(|(_, (value, unit))| format!("{}{SPACE}{unit}", count(*value))).collect::<Vec<_>>().join(" ")
}

/// A length of time as far as an estimate goes: `40 s`, `5 min`, `3 h 20 min`.
pub(crate) fn roughly(seconds: f64) -> String {
    let step = match seconds {
        seconds if seconds < 60.0 => 10.0,
        seconds if seconds < 3_600.0 => 60.0,
        seconds if seconds < 86_400.0 => 600.0,
        _ => 3_600.0,
    };
    // Rounded up: what ends sooner than it was said disappoints nobody.
    length((seconds / step).ceil() * step)
}

#[cfg(test)]
#[path = "numbers_tests.rs"]
mod tests;
