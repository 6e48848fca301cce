//! Standstills: long periods in which a run seems to have started no iteration, because the clock of its host was set
//! or the host was suspended. The number of iterations divided by the length of such a run is not a rate.

use peernet_clock::WallTime;

/// Minimum number of iterations for a standstill. In a run with fewer iterations, a pause of more than half of the run
/// may be one slow iteration.
const MIN_ITERATIONS: u64 = 100;
/// Longest pause that can be a wait for an answer or a model, seconds.
const MAX_WAIT_S: f64 = 600.0;

/// Length and iterations of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunExtent {
    /// Start of the run.
    pub started: WallTime,
    /// End of the run, or start of its last iteration so far.
    pub end: WallTime,
    /// Number of iterations.
    pub iterations: u64,
    /// Duration of the slowest iteration, seconds.
    pub slowest_s: f64,
}

/// Returns the length of the standstill of a run, seconds. `start_ranges` lists the time ranges in which iterations
/// started. The standstill is the longest pause between these ranges, or between the last range and the end of the run.
/// `None` unless this pause is longer than each of these: half of the run, ten minutes, and the slowest iteration. The
/// time before the first range does not count, because it may be the warm-up.
pub fn standstill(
    run: &RunExtent,
    start_ranges: impl IntoIterator<Item = (WallTime, WallTime)>,
) -> Option<f64> {
    if run.iterations < MIN_ITERATIONS {
        return None;
    }
    // The end of the run ends the last pause.
    let mut ranges: Vec<_> = start_ranges.into_iter().chain([(run.end, run.end)]).collect();
    ranges.sort();
    let (mut longest_s, mut pause_start) = (0.0_f64, ranges.first()?.1);
    for (from, to) in ranges {
        longest_s = longest_s.max((from - pause_start).seconds());
        // Ranges may overlap, and then there is no pause between them.
        pause_start = pause_start.max(to);
    }
    let half_s = (run.end - run.started).seconds() / 2.0;
    (longest_s > half_s.max(run.slowest_s).max(MAX_WAIT_S)).then_some(longest_s)
}

#[cfg(test)]
mod tests {
    use peernet_clock::Span;

    use super::*;

    /// Returns the standstill of a run of `length_s` seconds. The run has buckets of iterations, each `bucket_s`
    /// seconds long, which begin `buckets` seconds after its start.
    fn standstill_s(iterations: u64, bucket_s: i64, buckets: &[i64], length_s: i64) -> Option<f64> {
        let started = WallTime::from_unix_nanos(1_800_000_000_000_000_000);
        let after = |seconds: i64| started + Span::from_seconds(seconds);
        let run = RunExtent { started, end: after(length_s), iterations, slowest_s: 0.1 };
        standstill(&run, buckets.iter().map(|at| (after(*at), after(at + bucket_s))))
    }

    #[test]
    fn clock_set_by_months_causes_standstill() {
        let days_s = 115 * 86_400;
        let length_s = standstill_s(895, 3_600, &[-1_800, days_s], days_s + 4).expect("a standstill");
        assert!((length_s - f64::from(days_s as i32 - 1_800)).abs() < 1e-6, "{length_s}");
        assert!(standstill_s(895, 1, &[0, 3_600], 3_601).is_some());
    }

    #[test]
    fn usual_pauses_are_no_standstill() {
        assert_eq!(standstill_s(895, 1, &[0, 1, 2, 3], 4), None);
        assert_eq!(standstill_s(3, 1, &[0, 3_600], 3_601), None, "the iterations are slow");
        assert_eq!(standstill_s(895, 1, &[3_600], 3_601), None, "the hour before was the warm-up");
        assert_eq!(standstill_s(895, 1, &[0, 60], 61), None, "an iteration may have waited for a model");
        let every_minute: Vec<i64> = (0..60).map(|minute| minute * 60).collect();
        assert_eq!(standstill_s(895, 1, &every_minute, 3_601), None);
    }
}
