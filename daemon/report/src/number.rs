//! Numbers as people read them: milliseconds, megabytes per second, as many digits as the error supports.

/// Most decimals of a figure in milliseconds: a tenth of a microsecond.
const MOST_DECIMALS: usize = 4;
/// Decimals of a figure in milliseconds beside its bound.
const LEAST_WITHIN: usize = 2;
const MOST_WITHIN: usize = 3;
const MINUS: char = '−';

/// From this on a number is written with its power of ten: its digits say nothing any more.
const HUGE: f64 = 1e12;

/// Below this it is as well, where so small a number is told from zero at all.
const TINY: f64 = 1e-12;
/// No number has more decimals that say something.
const MOST_DIGITS: usize = 17;

/// A number with a fixed count of decimals: a true minus sign, thousands with commas, no signed zero. From 10¹² on, and
/// below 10⁻¹² where the decimals reach that far, four significant digits and the power of ten: `−1.234e300`.
pub fn fixed(value: f64, decimals: usize) -> String {
    let decimals = decimals.min(MOST_DIGITS);
    let is_tiny = value != 0.0 && value.abs() < TINY && decimals == MOST_DIGITS;
    if (value.abs() >= HUGE && value.is_finite()) || is_tiny {
        let sign = if value < 0.0 { MINUS.to_string() } else { String::new() };
        return format!("{sign}{:.3e}", value.abs());
    }
    let digits = format!("{:.decimals$}", value.abs());
    let (whole, fraction) = digits.split_once('.').map_or((digits.as_str(), None), |(w, f)| (w, Some(f)));
    let mut text = String::new();
    if value < 0.0 && digits.bytes().any(|digit| (b'1'..=b'9').contains(&digit)) {
        text.push(MINUS);
    }
    for (index, digit) in whole.chars().enumerate() {
        if index > 0 && (whole.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    if let Some(fraction) = fraction {
        text.push('.');
        text.push_str(fraction);
    }
    text
}

/// So many of something: `1 iteration`, `2,000 iterations`.
pub fn counted(count: u64, what: &str) -> String {
    format!("{} {what}{}", fixed(count as f64, 0), if count == 1 { "" } else { "s" })
}

/// A number with three significant digits.
pub fn significant(value: f64) -> String {
    fixed(value, decimals(value, 3))
}

/// Seconds as milliseconds with three significant digits, without the unit.
pub fn milliseconds(seconds: f64) -> String {
    let value = seconds * 1e3;
    fixed(value, decimals(value, 3).min(MOST_DECIMALS))
}

/// Seconds with their margin, as milliseconds: `0.0612 ± 0.0042`, to the margin's second digit.
pub fn milliseconds_with(seconds: f64, margin: Option<f64>) -> String {
    let Some(margin) = margin.filter(|margin| margin.is_finite()) else { return milliseconds(seconds) };
    let decimals = match margin {
        0.0 => decimals(seconds * 1e3, 3),
        margin => decimals(margin * 1e3, 2),
    };
    let decimals = decimals.min(MOST_DECIMALS);
    format!("{} ± {}", fixed(seconds * 1e3, decimals), fixed(margin * 1e3, decimals))
}

/// An interval of seconds, as milliseconds: `0.012 – 0.123`, to the second digit of its half width. One figure where
/// the ends are the same.
pub fn milliseconds_between((lo, hi): (f64, f64)) -> String {
    if lo == hi {
        return milliseconds(lo);
    }
    let decimals = decimals((hi - lo) / 2.0 * 1e3, 2).min(MOST_DECIMALS);
    between(fixed(lo * 1e3, decimals), &fixed(hi * 1e3, decimals))
}

/// Two ends; a dash next to a minus sign would be hard to read.
fn between(lo: String, hi: &str) -> String {
    match (lo == hi, lo.starts_with(MINUS) || hi.starts_with(MINUS)) {
        (true, _) => lo,
        (false, true) => format!("{lo} to {hi}"),
        (false, false) => format!("{lo} – {hi}"),
    }
}

/// The decimals of figures in milliseconds of which is known how far they can be off, as on the dashboard: two, or
/// three where the half width has its second digit there. All figures of a stage have as many, so that they compare.
pub fn decimals_within(half_width: Option<f64>) -> usize {
    match half_width {
        None => LEAST_WITHIN,
        // Exact: as fine as it is measured.
        Some(0.0) => MOST_WITHIN,
        Some(half_width) => decimals(half_width * 1e3, 2).clamp(LEAST_WITHIN, MOST_WITHIN),
    }
}

/// How far a delay can be off, as milliseconds: `±0.65`, `±0.006`; `exact` where it cannot.
pub fn bound_milliseconds(half_width: f64) -> String {
    if half_width == 0.0 {
        return "exact".to_owned();
    }
    let decimals = decimals(half_width * 1e3, 2).min(MOST_WITHIN);
    let text = fixed(half_width * 1e3, decimals);
    if text.bytes().any(|digit| (b'1'..=b'9').contains(&digit)) {
        format!("±{text}")
    } else {
        "±<0.001".to_owned()
    }
}

/// Bits per second as megabytes per second, three significant digits, without the unit.
pub fn megabytes_per_second(bits_per_second: f64) -> String {
    significant(bits_per_second / 8e6)
}

/// Bits per second with their margin, as megabytes per second: `943 ± 14`, to the margin's second digit.
pub fn megabytes_per_second_with(bits_per_second: f64, margin: f64) -> String {
    let [rate, margin] = [bits_per_second, margin].map(|bits| bits / 8e6);
    let decimals = decimals(if margin > 0.0 { margin } else { rate }, 2).min(MOST_DECIMALS);
    format!("{} ± {}", fixed(rate, decimals), fixed(margin, decimals))
}

/// An interval of bits per second, as megabytes per second; one without an upper end is open.
pub fn megabytes_per_second_between((lo, hi): (f64, Option<f64>)) -> String {
    match hi {
        Some(hi) => {
            if lo == hi {
                return megabytes_per_second(lo);
            }
            let decimals = decimals((hi - lo) / 2.0 / 8e6, 2).min(1);
            between(fixed(lo / 8e6, decimals), &fixed(hi / 8e6, decimals))
        }
        None => format!("≥ {}", megabytes_per_second(lo)),
    }
}

/// An error in seconds, as milliseconds with two significant digits, without the unit.
pub fn error_milliseconds(seconds: f64) -> String {
    fixed(seconds * 1e3, decimals(seconds * 1e3, 2).min(MOST_DECIMALS))
}

/// A size with the largest unit that leaves at least 1: `100 B`, `1.2 MB`.
pub fn bytes(bytes: f64) -> String {
    let (value, unit) = match bytes {
        b if b >= 999_500_000.0 => (b / 1e9, "GB"),
        b if b >= 999_500.0 => (b / 1e6, "MB"),
        b if b >= 999.5 => (b / 1e3, "kB"),
        b => (b, "B"),
    };
    let text = significant(value);
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text} {unit}")
}

/// How many decimals show so many significant digits.
pub fn decimals(value: f64, digits: i32) -> usize {
    if value == 0.0 || !value.is_finite() {
        return usize::try_from(digits - 1).unwrap_or_default();
    }
    // Rounding may carry into the next place: 0.09996 has three digits as 0.100.
    let magnitude = value.abs().log10().floor();
    let unit = 10_f64.powf(magnitude - f64::from(digits - 1));
    let magnitude = ((value.abs() / unit).round() * unit).log10().floor();
    usize::try_from(digits - 1 - magnitude as i32).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_as_people_write_them() {
        assert_eq!(fixed(-1234567.891, 2), "−1,234,567.89");
        assert_eq!((fixed(-0.001, 2), fixed(999.5, 0)), ("0.00".to_owned(), "1,000".to_owned()));
        assert_eq!([0.0613, 16.12, 141.0, 0.09996].map(significant), ["0.0613", "16.1", "141", "0.100"]);
        assert_eq!(milliseconds_with(61.23e-6, Some(4.21e-6)), "0.0612 ± 0.0042");
        assert_eq!(milliseconds_with(-2.0142e-3, Some(0.11e-3)), "−2.01 ± 0.11");
        assert_eq!(milliseconds_between((0.0, 123.4e-6)), "0.000 – 0.123");
        assert_eq!(
            (megabytes_per_second(8e6 * 943.4), error_milliseconds(61.2e-6)),
            ("943".into(), "0.061".into())
        );
        assert_eq!(megabytes_per_second_with(8e6 * 943.4, 8e6 * 13.6), "943 ± 14");
        assert_eq!(megabytes_per_second_with(8e6 * 1.234, 8e6 * 0.056), "1.234 ± 0.056");
        assert_eq!(megabytes_per_second_between((8e6 * 930.3, Some(8e6 * 957.1))), "930 – 957");
        assert_eq!(megabytes_per_second_between((8e6, None)), "≥ 1.00");
        assert_eq!(milliseconds_between((-1.201_538, -1.201_350)), "−1,201.538 to −1,201.350");
        assert_eq!(
            [100.0, 1_000.0, 1.2e6, 4e6, 26_207.0].map(bytes),
            ["100 B", "1 kB", "1.2 MB", "4 MB", "26.2 kB"]
        );
    }

    #[test]
    fn huge_numbers_have_their_power_of_ten() {
        assert_eq!(
            [-1e300, 1.23456e12, 1e12 - 1.0].map(|n| fixed(n, 0)),
            ["−1.000e300", "1.235e12", "999,999,999,999"]
        );
        assert_eq!(
            [-1.23456e-300, 0.0, 1.0].map(|n| fixed(n, 302)),
            ["−1.235e-300", "0.00000000000000000", "1.00000000000000000"]
        );
        assert_eq!(milliseconds(-1e300), "−1.000e303");
    }

    #[test]
    fn what_has_no_width_keeps_its_own_digits() {
        assert_eq!([30.2e-6, 61.2e-6].map(|ms| milliseconds_between((ms, ms))), ["0.0302", "0.0612"]);
        assert_eq!(milliseconds_between((30.21e-6, 30.24e-6)), "0.0302");
        assert_eq!(megabytes_per_second_between((8e6 * 3752.4, Some(8e6 * 3752.4))), "3,752");
        assert_eq!(milliseconds_with(6.31e-3, Some(0.0)), "6.31 ± 0.00");
    }

    #[test]
    fn figures_within_a_bound_have_the_digits_of_the_dashboard() {
        let decimals = [None, Some(0.0), Some(60e-6), Some(0.65e-3), Some(15e-3)].map(decimals_within);
        assert_eq!(decimals, [2, 3, 3, 2, 2]);
        let bounds = [0.0, 0.1e-6, 6e-6, 60e-6, 0.65e-3, 15e-3].map(bound_milliseconds);
        assert_eq!(bounds, ["exact", "±<0.001", "±0.006", "±0.060", "±0.65", "±15"]);
    }
}
