//! Standstills: long times in which a run started no iteration, because the clock of its host was set or the host was
//! suspended. The number of iterations divided by the length of such a run is not a rate.

use peernet_clock::WallTime;

/// Minimum number of iterations for a standstill. In a run with fewer iterations, a pause of more than half of its time may be one slow
/// iteration.
const MIN_ITERATIONS: u64 = 100;
/// Time that is longer than any wait for an answer or a model, seconds.
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

/// Returns the length of the standstill of a run, seconds. `busy` lists the time ranges in which iterations started.
/// The standstill is the longest pause between these ranges, or between the last range and the end of the run. `None`
/// unless this pause is longer than each of these: half of the run, ten minutes, and the slowest iteration. The time
/// before the first range does not count, because it may be the warm-up.
pub fn standstill(run: &RunExtent, busy: impl IntoIterator<Item = (WallTime, WallTime)>) -> Option<f64> {
    if run.iterations < MIN_ITERATIONS {
        return None;
    }
    let mut busy: Vec<_> = busy.into_iter().chain([(run.end, run.end)]).collect();
    busy.sort();
    let (mut longest_s, mut busy_until) = (0.0_f64, busy.first()?.1);
    for (from, to) in busy {
        longest_s = longest_s.max((from - busy_until).seconds());
        busy_until = busy_until.max(to);
    }
    let half_s = (run.end - run.started).seconds() / 2.0;
    (longest_s > half_s.max(run.slowest_s).max(MAX_WAIT_S)).then_some(longest_s)
}

#[cfg(test)]
mod tests {
    use peernet_clock::Span;

    use super::*;

    /// Returns the standstill of a run with buckets of iterations at `busy` seconds after its start and a length of `seconds`.
    fn found(iterations: u64, bucket_s: i64, busy: &[i64], seconds: i64) -> Option<f64> {
        let started = WallTime::from_unix_nanos(1_800_000_000_000_000_000);
        let after = |seconds: i64| started + Span::from_seconds(seconds);
        let run = RunExtent { started, end: after(seconds), iterations, slowest_s: 0.1 };
        standstill(&run, busy.iter().map(|at| (after(*at), after(at + bucket_s))))
    }

    #[test]
    fn clock_set_by_months_causes_standstill() {
        let days = 115 * 86_400;
        let length_s = found(895, 3_600, &[-1_800, days], days + 4).expect("a standstill");
        assert!((length_s - f64::from(days as i32 - 1_800)).abs() < 1e-6, "{length_s}");
        assert!(found(895, 1, &[0, 3_600], 3_601).is_some());
    }

    #[test]
    fn usual_pauses_are_no_standstill() {
        assert_eq!(found(895, 1, &[0, 1, 2, 3], 4), None);
        assert_eq!(found(3, 1, &[0, 3_600], 3_601), None, "that is how slow it is");
        assert_eq!(found(895, 1, &[3_600], 3_601), None, "that was the warm-up");
        assert_eq!(found(895, 1, &[0, 60], 61), None, "one may have waited for a model");
        let every_minute: Vec<i64> = (0..60).map(|minute| minute * 60).collect();
        assert_eq!(found(895, 1, &every_minute, 3_601), None);
    }
}
