//! Formatting of durations from seconds to days.

use super::{NONE, SPACE, count, fixed_or_less_than};

/// Formats a duration: `0.4 s`, `35 s`, `4 min 12 s`, `2 h 5 min`, `3 d 4 h`.
pub fn long_duration(seconds: f64) -> String {
    if !seconds.is_finite() || seconds < 0.0 {
        return NONE.to_owned();
    }
    // From 9.95 s on, one decimal would be rounded to `10.0`.
    if seconds < 9.95 {
        return format!("{}{SPACE}s", fixed_or_less_than(seconds, 1));
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

/// Formats a duration with the precision of an estimate: `40 s`, `5 min`, `3 h 20 min`.
pub fn estimated_duration(seconds: f64) -> String {
    let step = match seconds {
        seconds if seconds < 60.0 => 10.0,
        seconds if seconds < 3_600.0 => 60.0,
        seconds if seconds < 86_400.0 => 600.0,
        _ => 3_600.0,
    };
    // The duration is rounded up, because it does no harm if something ends earlier than announced.
    long_duration((seconds / step).ceil() * step)
}
