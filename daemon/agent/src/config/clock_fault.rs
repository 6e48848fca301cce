//! The table `[clock_fault]`: clock fault injection.

use peernet_clock::{ClockFaultStep, ClockFaults, Span, SteppedClock, WallTime};
use serde::{Deserialize, Serialize};

/// `[clock_fault]`: faults that are injected into the clocks, to check that clock faults do not change the reported
/// delays.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClockFaultConfig {
    /// Offset of the wall clock and of the free-running clock from true time, from the start on; milliseconds, at most
    /// 1e10 in either direction (four months). Default: 0.
    pub offset_ms: f64,
    /// Drift of both clocks; positive is fast; parts per million, at most 100000 in either direction. Default: 0.
    pub drift_ppm: f64,
    /// Steps in chronological order. Default: none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub steps: Vec<ClockFaultStepConfig>,
    /// Claim of the host about its wall clock. Default: `none`.
    pub discipline: ClaimPolicy,
}

/// `steps = [{ at_s = …, by_ms = …, clock = … }]`: one step of a clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClockFaultStepConfig {
    /// Time of the step in seconds after the start of the agent.
    pub at_s: f64,
    /// Size of the step in milliseconds; positive is forward.
    pub by_ms: f64,
    /// Clock that is stepped: `wall`, whose steps the agent notices at once, or `raw`, the free-running clock, whose
    /// steps nothing on the host notices. Default: `wall`.
    #[serde(default, skip_serializing_if = "SteppedClock::is_wall")]
    pub clock: SteppedClock,
}

/// Claim that a host with clock faults makes about its wall clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ClaimPolicy {
    /// No claim, like a host without a time daemon.
    #[default]
    None,
    /// The exact error with an uncertainty of 1 µs plus the drift until the next claim, like a perfect time daemon.
    Exact,
    /// The claim of the real clock's daemon, as if the daemon did not know of the fault.
    Unaware,
}

impl ClockFaultConfig {
    /// Returns the faults of a clock that are injected from the true time `since` on.
    pub fn clock_faults(&self, since: WallTime) -> ClockFaults {
        let step = |step: &ClockFaultStepConfig| ClockFaultStep {
            at: Span::from_seconds_f64(step.at_s),
            by: span_from_millis(step.by_ms),
            clock: step.clock,
        };
        ClockFaults {
            offset: span_from_millis(self.offset_ms),
            drift_ppm: self.drift_ppm,
            steps: self.steps.iter().map(step).collect(),
            since,
        }
    }
}

fn span_from_millis(milliseconds: f64) -> Span {
    Span::from_seconds_f64(milliseconds * 1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wall_error_is_offset_plus_drift_plus_past_steps() {
        let config: ClockFaultConfig =
            toml::from_str("offset_ms = 1000\ndrift_ppm = -50.5\nsteps = [{ at_s = 20, by_ms = -3000 }]")
                .expect("it is a table of [clock_fault]");

        let since = WallTime::from_unix_nanos(7);
        let clock_faults = config.clock_faults(since);
        let ten_seconds = Span::from_seconds(10);
        assert_eq!(clock_faults.wall_error_at(since + ten_seconds), Span::from_micros(1_000_000 - 505));
        let error_after_step = Span::from_micros(1_000_000 - 3_000_000 - 1010);
        assert_eq!(clock_faults.wall_error_at(since + ten_seconds + ten_seconds), error_after_step);
    }
}
