//! Progress of a run, for its display.

use std::fmt;

use peernet_statistics::{Summary, number};
use peernet_stream::Condition;
use serde::{Deserialize, Serialize};

use crate::foreground::{describe_quantiles, estimated_duration};

/// Progress of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ProgressReport {
    /// Current activity.
    pub(crate) phase: Phase,
    /// Number of finished iterations.
    pub(crate) done: u64,
    /// Number of finished iterations after the warm-up without an answer, or with one that the actuator failed to act
    /// on.
    pub(crate) failed: u64,
    /// Number of such iterations in the warm-up.
    pub(crate) failed_in_warm_up: u64,
    /// Description of the first failed iteration with its reason, as a clause: `iteration 3 failed: …`.
    pub(crate) first_failure: Option<String>,
    /// Total number of iterations; `None` if a time limits the run.
    #[serde(rename = "of")]
    pub(crate) iterations: Option<u64>,
    /// Iterations per second after the warm-up; `None` while unknown.
    pub(crate) rate: Option<f64>,
    /// Totals of the successful iterations after the warm-up, seconds.
    pub(crate) totals: Summary,
    /// Estimated remaining time, seconds; `None` while unknown.
    pub(crate) left_s: Option<f64>,
    /// Description of an unexpected wait.
    pub(crate) trouble: Option<String>,
}

impl ProgressReport {
    /// Returns the fraction of the iterations that are finished, 0 to 1; `None` if only a time limits the run.
    pub(crate) fn fraction_done(&self) -> Option<f64> {
        self.iterations.map(|count| self.done as f64 / count.max(1) as f64)
    }
}

impl fmt::Display for ProgressReport {
    /// Writes the progress in words: `120 of 10,005, 3 failed, 9.81 iterations/s, total p50 101 ms, p99 104 ms, 17 min
    /// left`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.phase == Phase::Starting {
            return f.write_str("starting");
        }
        f.write_str(&number::count(self.done))?;
        if let Some(iterations) = self.iterations {
            write!(f, " of {}", number::count(iterations))?;
        }
        if self.failed > 0 {
            write!(f, ", {} failed", number::count(self.failed))?;
        }
        if self.failed_in_warm_up > 0 {
            write!(f, ", {} in the warm-up failed", number::count(self.failed_in_warm_up))?;
        }
        // There is no rate and no median during the warm-up.
        if let Some(rate) = self.rate {
            write!(f, ", {} iterations/s", number::rate(rate))?;
        }
        if let Some(p50) = self.totals.quantile(0.5) {
            write!(f, ", total {}", describe_quantiles(p50, self.totals.p99()))?;
        }
        self.left_s.map_or(Ok(()), |left| write!(f, ", {} left", estimated_duration(left)))
    }
}

/// Activity of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Phase {
    /// The agent sets up sensor and model, and connects to the peer.
    Starting,
    /// The agent measures warm-up iterations.
    WarmUp,
    /// The agent measures iterations after the warm-up.
    Measuring,
    /// The agent waits for an unreachable peer.
    Waiting,
    /// The program writes the files of results.
    Writing,
}

/// Display of a run's progress.
pub(crate) trait ProgressDisplay {
    /// Shows the conditions of the hosts when the run begins.
    fn show_start(&mut self, _conditions: &[Condition]) {}

    /// Shows the progress, several times a second.
    fn show(&mut self, report: &ProgressReport);

    /// Waits until the other edges of the same run have ended their measurement, because writing results and drawing
    /// figures take CPU time from them.
    fn wait_for_other_edges(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_is_shown_in_one_line() {
        let mut totals = Summary::default();
        totals.record(0.1012);
        let report = ProgressReport {
            phase: Phase::Measuring,
            done: 120,
            failed: 0,
            failed_in_warm_up: 0,
            first_failure: None,
            iterations: Some(10_005),
            rate: Some(9.81),
            totals,
            left_s: Some(1007.6),
            trouble: None,
        };
        assert_eq!(report.to_string(), "120 of 10,005, 9.81 iterations/s, total p50 101 ms, 17 min left");
        let failing = ProgressReport { failed: 120, totals: Summary::default(), ..report.clone() };
        assert_eq!(failing.to_string(), "120 of 10,005, 120 failed, 9.81 iterations/s, 17 min left");
        let warming_up = ProgressReport {
            done: 3,
            failed_in_warm_up: 2,
            rate: None,
            totals: Summary::default(),
            ..report
        };
        assert_eq!(warming_up.to_string(), "3 of 10,005, 2 in the warm-up failed, 17 min left");
    }
}
