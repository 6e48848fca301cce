//! Times of day along an axis.

/// Distances between two marks, seconds.
const STEPS: [i64; 9] = [60, 120, 300, 600, 1_800, 3_600, 7_200, 14_400, 86_400];
/// Maximum number of steps on an axis.
const MOST: i64 = 12;
/// Distance of marks from an end, as a share of the axis, below which their labels would extend beyond it.
const END: f64 = 0.015;

/// Returns round times of day after `from` and their places from 0 to 1, on an axis of this length in seconds. Times are seconds of Unix
/// time; `east` is the number of seconds by which local time is ahead of UTC.
pub fn times_of_day(from: f64, length: f64, east: i64) -> Vec<(i64, f64)> {
    let fits = |step: &i64| length / *step as f64 <= MOST as f64;
    let step = STEPS.into_iter().find(fits).unwrap_or(STEPS[STEPS.len() - 1]);
    let first = (from.floor() as i64 + east).div_euclid(step) + 1;
    let times = (first..first + 2 * MOST).map(|number| number * step - east);
    let placed = times.map(|time| (time, (time as f64 - from) / length));
    placed.filter(|(_, at)| (END..=1.0 - END).contains(at)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_round_in_local_time() {
        let places = times_of_day(7_200.0 + 30.0, 600.0, 0);
        assert_eq!(places.len(), 10);
        assert_eq!(places[0], (7_260, 0.05));
        // India is five and a half hours ahead: its hours are the half hours of UTC.
        let hours: Vec<i64> = times_of_day(0.0, 30_000.0, 19_800).into_iter().map(|(time, _)| time).collect();
        assert_eq!(hours[..2], [1_800, 5_400]);
        assert!(times_of_day(0.0, 90.0 * 86_400.0, 0).len() <= 24);
    }
}
