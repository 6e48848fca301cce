//! Formatting of durations.

const DAY: u64 = 86_400;
/// Shortest duration that is given in days, seconds.
const MIN_DAYS: u64 = 10 * DAY;
/// Shortest duration that is given in years, seconds.
const MIN_YEARS: u64 = 3 * 365 * DAY;

/// Formats a duration with one or two units that grow with it. Minutes are rounded up; hours, days and years are
/// rounded down.
pub(crate) fn duration(seconds: f64) -> String {
    // A duration below half a second would be rounded to zero.
    if seconds > 0.0 && seconds < 0.5 {
        return format!("0.{} s", (seconds * 10.0).round().max(1.0));
    }
    match seconds.round() as u64 {
        seconds @ ..120 => format!("{seconds} s"),
        seconds @ ..7200 => format!("{} min", seconds.div_ceil(60)),
        seconds @ ..MIN_DAYS => format!("{} h {} min", seconds / 3600, seconds % 3600 / 60),
        seconds @ ..MIN_YEARS => format!("{} days", seconds / DAY),
        seconds => format!("{} years", seconds / (365 * DAY)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_grow_with_the_duration() {
        assert_eq!([90.4, 7199.0, 7300.0].map(duration), ["90 s", "120 min", "2 h 1 min"]);
        let day = 86_400.0;
        assert_eq!(
            [9.0 * day, 10.5 * day, 400.0 * day, 4000.0 * day].map(duration),
            ["216 h 0 min", "10 days", "400 days", "10 years"]
        );
        assert_eq!([0.0, 0.003, 0.34, 0.95, 1.4].map(duration), ["0 s", "0.1 s", "0.3 s", "1 s", "1 s"]);
    }
}
