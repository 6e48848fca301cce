//! Exact claim of a host about its clock with injected faults.

use peernet_clock::{ClockClaim, ClockFaults, DelaySource, Interval, Span, WallTime};

/// Half the width of the claim, without the drift.
const BOUND: Span = Span::from_micros(1);

/// Returns a claim that contains the clock's error at `true_time`. Unless the clock is stepped, the claim also contains
/// the error at any time within `reach` before or after `true_time`.
// The claim is also used for messages that were stamped before the claim was made.
pub(super) fn exact_claim(faults: &ClockFaults, true_time: WallTime, reach: Span) -> ClockClaim {
    let current_error = faults.wall_error_at(true_time);
    let drift = reach.drift(faults.drift_ppm.abs());
    let error = Interval { lo: current_error - drift - BOUND, hi: current_error + drift + BOUND };
    ClockClaim { source: DelaySource::Kernel, error }
}

#[cfg(test)]
mod tests {
    use peernet_clock::ClockFaultStep;

    use super::*;

    #[test]
    fn claim_contains_error_around_its_time() {
        let faults = ClockFaults {
            offset: Span::from_seconds(-1),
            drift_ppm: 50.0,
            steps: vec![ClockFaultStep::wall_step(Span::from_seconds(20), Span::from_seconds(3))],
            since: WallTime::from_unix_nanos(1_700_000_000_000_000_000),
        };
        let reach = Span::from_seconds(2);
        for seconds in [0, 10, 19, 21, 100_000] {
            let true_time = faults.since + Span::from_seconds(seconds);
            let claim = exact_claim(&faults, true_time, reach).error;
            assert!(claim.width() <= Span::from_micros(202), "{claim:?}");
            let (step_follows, step_precedes) = (seconds == 19, seconds == 21);
            for moment in [true_time - reach, true_time, true_time + reach] {
                let error = faults.wall_error_at(moment);
                let is_inside = claim.lo <= error && error <= claim.hi;
                let is_across_step =
                    (step_follows && moment > true_time) || (step_precedes && moment < true_time);
                assert!(is_inside || is_across_step, "{seconds}: {error} in {claim:?}");
            }
        }
    }
}
