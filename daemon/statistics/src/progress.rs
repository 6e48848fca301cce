//! Rate and remaining time of work that consists of counted events.

/// Returns the events per second; `None` without events or without time.
pub fn mean_rate(events: u64, seconds: f64) -> Option<f64> {
    (events > 0 && seconds > 0.0).then(|| events as f64 / seconds)
}

/// Returns the remaining time if the work goes on as fast as before, seconds. `fraction_done`, 0 to 1, was done in
/// `elapsed_s` seconds. `None` before any progress.
pub fn remaining_seconds(fraction_done: f64, elapsed_s: f64) -> Option<f64> {
    (fraction_done > 0.0 && elapsed_s > 0.0).then(|| elapsed_s * (1.0 / fraction_done - 1.0).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_progress_has_no_rate_and_no_end() {
        assert_eq!([mean_rate(3, 2.0), mean_rate(0, 2.0), mean_rate(3, 0.0)], [Some(1.5), None, None]);
        let remaining = [(0.25, 2.0), (1.5, 2.0), (0.0, 2.0), (0.25, 0.0)];
        let remaining =
            remaining.map(|(fraction_done, elapsed_s)| remaining_seconds(fraction_done, elapsed_s));
        assert_eq!(remaining, [Some(6.0), Some(0.0), None, None]);
    }
}
