//! Rate and remaining time of work that consists of counted events.

/// Returns the events per second; `None` without events or without time.
pub fn mean_rate(events: u64, seconds: f64) -> Option<f64> {
    (events > 0 && seconds > 0.0).then(|| events as f64 / seconds)
}

/// Returns the remaining time if the work goes on as fast as before, and ends after `limit_s` seconds at the latest,
/// seconds. `fraction_done`, 0 to 1, was done in `elapsed_s` seconds. `None` before any progress without a limit.
pub fn remaining_seconds(fraction_done: Option<f64>, elapsed_s: f64, limit_s: Option<f64>) -> Option<f64> {
    let fraction_done = fraction_done.filter(|fraction| *fraction > 0.0 && elapsed_s > 0.0);
    let by_work = fraction_done.map(|fraction| elapsed_s * (1.0 / fraction - 1.0));
    by_work.into_iter().chain(limit_s).map(|seconds| seconds.max(0.0)).reduce(f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_progress_has_no_rate_and_no_end() {
        assert_eq!([mean_rate(3, 2.0), mean_rate(0, 2.0), mean_rate(3, 0.0)], [Some(1.5), None, None]);
        let remaining = [(0.25, 2.0), (1.5, 2.0), (0.0, 2.0), (0.25, 0.0)];
        let remaining = remaining
            .map(|(fraction_done, elapsed_s)| remaining_seconds(Some(fraction_done), elapsed_s, None));
        assert_eq!(remaining, [Some(6.0), Some(0.0), None, None]);
    }

    #[test]
    fn first_limit_ends_work() {
        let remaining = [(Some(0.25), 5.0), (Some(0.25), 7.0), (None, 5.0), (Some(0.25), -1.0)];
        let remaining =
            remaining.map(|(fraction_done, limit_s)| remaining_seconds(fraction_done, 2.0, Some(limit_s)));
        assert_eq!(remaining, [Some(5.0), Some(6.0), Some(5.0), Some(0.0)]);
    }
}
