//! Values whose bounds follow from clocks, in ms: as many digits as the bound supports, but none below a microsecond, which
//! no clock of another host is known to.

use super::milliseconds::own_decimals;
use super::{EXACT, SPACE, between, decimals, fixed, measured, milliseconds, signed};

/// Decimals of a microsecond.
const MOST: usize = 3;

/// The decimals of a value whose bound is known: as far as the bound's second digit. An exact one has those of its own size.
fn decimals_within(seconds: f64, half_width: f64) -> usize {
    if half_width > 0.0 { decimals(half_width * 1e3, 2).min(MOST) } else { own_decimals(seconds * 1e3) }
}

/// How far a value can be off: `±0.65`, `±0.006`; nothing at all is `exact`.
pub fn bound_ms(half_width: f64) -> String {
    if half_width == 0.0 {
        return EXACT.to_owned();
    }
    format!("±{}", measured(half_width * 1e3, decimals(half_width * 1e3, 2).min(MOST)))
}

/// The same with its unit: `±0.65 ms`, `exact`.
pub fn bound(half_width: f64) -> String {
    let unit = if half_width == 0.0 { String::new() } else { format!("{SPACE}ms") };
    format!("{}{unit}", bound_ms(half_width))
}

/// Both ends of an interval, with the digits that its width supports.
pub fn ends_ms(lo: f64, hi: f64) -> [String; 2] {
    let decimals = decimals_within(hi, (hi - lo) / 2.0);
    [lo, hi].map(|end| fixed(end * 1e3, decimals))
}

/// An interval, finer where it is narrow: `5.66 – 6.93`, `0.394 – 0.405`, `−1.54 to −1.35`. One figure where the ends are
/// the same.
pub fn interval_ms(lo: f64, hi: f64) -> String {
    if lo == hi { milliseconds(lo) } else { between(ends_ms(lo, hi)) }
}

/// A value that lies within an interval, with the digits that its width supports: `0.043`, `6.3`.
pub fn within_ms(seconds: f64, (lo, hi): (f64, f64)) -> String {
    fixed(seconds * 1e3, decimals_within(seconds, (hi - lo) / 2.0))
}

/// A difference with its sign, for a value that lies within an interval.
pub fn signed_within_ms(seconds: f64, (lo, hi): (f64, f64)) -> String {
    signed(seconds * 1e3, decimals_within(seconds, (hi - lo) / 2.0))
}

/// How far something may move: `−0.65 to +0.63`.
pub fn shift_ms(lo: f64, hi: f64) -> String {
    let decimals = decimals_within(hi, (hi - lo) / 2.0);
    format!("{} to {}", signed(lo * 1e3, decimals), signed(hi * 1e3, decimals))
}

/// A clock offset with its sign and the digits that its bound supports: `+1,204.18`, `−1,002.698`, `+250`.
pub fn offset_ms(seconds: f64, half_width: f64) -> String {
    signed(seconds * 1e3, if half_width > 0.0 { decimals_within(seconds, half_width) } else { 2 })
}
