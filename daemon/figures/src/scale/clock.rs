//! Times of day along an axis.

/// Possible distances between two marks, seconds. If even marks a day apart are too many for an
/// axis, the distance is a multiple of a day.
const STEPS_S: [i64; 9] = [60, 120, 300, 600, 1_800, 3_600, 7_200, 14_400, DAY_S];
/// Length of a day, seconds.
const DAY_S: i64 = 86_400;
/// Maximum number of steps on an axis.
const MAX_STEPS: i64 = 12;
/// Minimum distance of a mark from an end, as a share of the axis. The label of a nearer mark would extend beyond the
/// axis.
const MIN_END_DISTANCE: f64 = 0.015;

/// Returns round times of day, each with its position from 0 to 1, on an axis that begins at the time `from` and is
/// `length` seconds long. Times are seconds of Unix time. `utc_offset` is the number of seconds by which local time is
/// ahead of UTC.
pub fn times_of_day(from: f64, length: f64, utc_offset: i64) -> Vec<(i64, f64)> {
    let fits = |step: &i64| length / *step as f64 <= MAX_STEPS as f64;
    let whole_days = || (length / (MAX_STEPS * DAY_S) as f64).ceil() as i64 * DAY_S;
    let step = STEPS_S.into_iter().find(fits).unwrap_or_else(whole_days);
    let first_number = (from.floor() as i64 + utc_offset).div_euclid(step) + 1;
    let times = (first_number..=first_number + MAX_STEPS).map(|number| number * step - utc_offset);
    let with_positions = times.map(|time| (time, (time as f64 - from) / length));
    with_positions.filter(|(_, at)| (MIN_END_DISTANCE..=1.0 - MIN_END_DISTANCE).contains(at)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_round_in_local_time() {
        let marks = times_of_day(7_200.0 + 30.0, 600.0, 0);
        assert_eq!(marks.len(), 10);
        assert_eq!(marks[0], (7_260, 0.05));
        // India is five and a half hours ahead of UTC, so full hours in India are half past the hour in UTC.
        let hours: Vec<i64> = times_of_day(0.0, 30_000.0, 19_800).into_iter().map(|(time, _)| time).collect();
        assert_eq!(hours[..2], [1_800, 5_400]);
    }

    #[test]
    fn axis_of_months_has_marks_up_to_end() {
        let marks = times_of_day(0.0, 90.0 * DAY_S as f64, 0);
        let days: Vec<i64> = marks.iter().map(|(time, _)| time / DAY_S).collect();
        assert_eq!(days, [8, 16, 24, 32, 40, 48, 56, 64, 72, 80, 88]);
    }
}
