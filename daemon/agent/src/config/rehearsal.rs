//! `[rehearsal]`

use peernet_clock::{ClockFaultStep, ClockFaults, Span, SteppedClock, WallTime};
use serde::{Deserialize, Serialize};

/// `[rehearsal]`: makes this host's clocks wrong on purpose, to see that the reported delays do not move.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RehearsalConfig {
    /// Ahead of true time from the start; milliseconds, at most 1e10 either way (four months). Default: 0.
    pub offset_ms: f64,
    /// Runs fast; parts per million, at most 100000 either way. Default: 0.
    pub drift_ppm: f64,
    /// Steps, in the order of time. Default: none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub steps: Vec<RehearsedStepConfig>,
    /// What the host claims about its clock. Default: `none`.
    pub discipline: RehearsedDiscipline,
}

/// `steps = [{ at_s = …, by_ms = …, clock = … }]`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RehearsedStepConfig {
    /// Seconds after the start of the agent.
    pub at_s: f64,
    /// Set forward by so many milliseconds; negative: back.
    pub by_ms: f64,
    /// Which clock: `wall`, the step is noticed at once; or `raw`, the free-running clock, nothing on the host notices it.
    /// Default: `wall`.
    #[serde(default, skip_serializing_if = "SteppedClock::is_wall")]
    pub clock: SteppedClock,
}

/// What a rehearsed host claims about its clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RehearsedDiscipline {
    /// Nothing, like a host without a time daemon.
    #[default]
    None,
    /// Its error exactly, ± 1 µs and what it drifts until the next claim: a perfect time daemon.
    Exact,
    /// What the real clock's daemon says: a host whose clock is wrong without its daemon knowing.
    Unaware,
}

impl RehearsalConfig {
    /// What is wrong with a clock whose rehearsal began when the true one showed `since`.
    pub fn description(&self, since: WallTime) -> ClockFaults {
        let step = |step: &RehearsedStepConfig| ClockFaultStep {
            at: Span::from_seconds_f64(step.at_s),
            by: milliseconds(step.by_ms),
            clock: step.clock,
        };
        ClockFaults {
            offset: milliseconds(self.offset_ms),
            drift_ppm: self.drift_ppm,
            steps: self.steps.iter().map(step).collect(),
            since,
        }
    }
}

fn milliseconds(milliseconds: f64) -> Span {
    Span::from_seconds_f64(milliseconds * 1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rehearsal_is_told_in_figures() {
        let config: RehearsalConfig =
            toml::from_str("offset_ms = 1000\ndrift_ppm = -50.5\nsteps = [{ at_s = 20, by_ms = -3000 }]")
                .expect("it is a table of [rehearsal]");

        let since = WallTime::from_unix_nanos(7);
        let description = config.description(since);
        let ten_seconds = Span::from_seconds(10);
        assert_eq!(description.error_at(since + ten_seconds), Span::from_micros(1_000_000 - 505));
        let after = Span::from_micros(1_000_000 - 3_000_000 - 1010);
        assert_eq!(description.error_at(since + ten_seconds + ten_seconds), after);
    }
}
