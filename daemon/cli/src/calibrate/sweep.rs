//! Progress of the sweep.

use peernet_analysis::calibration::{Sample, median_delay};
use peernet_clock::{Direction, MonoTime, Span};
use peernet_statistics::number::{self, NONE, bytes, count, milliseconds};
use peernet_statistics::{mean_rate, remaining_seconds};

use super::plan::Plan;
use crate::foreground::{Progress, estimated_duration};

/// Display of the sweep's progress.
pub(super) struct SweepDisplay {
    progress: Progress,
    limits: SweepLimits,
    started_at: MonoTime,
    /// Start of the sweep, or end of the last iteration of its warm-up.
    measuring_since: MonoTime,
}

/// Limits and extreme sizes of the sweep. The sweep ends at the limit that it reaches first.
struct SweepLimits {
    max_iterations: u64,
    max_seconds: f64,
    /// Smallest and largest payload size, bytes.
    size_range: (u64, u64),
}

impl SweepDisplay {
    pub(super) fn new(plan: &Plan, quiet: bool, now: MonoTime) -> Self {
        let sizes = plan.sizes();
        let size_range =
            (sizes.first().copied().unwrap_or_default(), sizes.last().copied().unwrap_or_default());
        let limits =
            SweepLimits { max_iterations: plan.all_iterations(), max_seconds: plan.seconds, size_range };
        Self { progress: Progress::new(quiet, now), limits, started_at: now, measuring_since: now }
    }

    /// Records the start of the first iteration.
    pub(super) const fn begin(&mut self, now: MonoTime) {
        self.started_at = now;
        self.measuring_since = now;
    }

    /// Records the end of an iteration of the warm-up.
    pub(super) const fn record_warm_up(&mut self, now: MonoTime) {
        self.measuring_since = now;
    }

    /// Returns the time at which the maximum duration ends.
    pub(super) fn time_limit(&self) -> MonoTime {
        self.measuring_since + Span::from_seconds_f64(self.limits.max_seconds)
    }

    /// Shows the state at `now`. If there is `trouble`, it replaces the state.
    pub(super) fn show(&mut self, samples: &[Sample], now: MonoTime, trouble: Option<String>) {
        let (limits, elapsed) = (&self.limits, (now - self.started_at).seconds());
        let limit_s = limits.max_seconds - (now - self.measuring_since).seconds();
        self.progress.show(now, trouble, || limits.describe(samples, elapsed, limit_s));
    }

    /// Removes the bar.
    pub(super) fn end(&self) {
        self.progress.end();
    }
}

impl SweepLimits {
    /// Describes the state `limit_s` seconds before the time limit. Also returns the fraction of the sweep that is done,
    /// from 0 to 1.
    fn describe(&self, samples: &[Sample], elapsed: f64, limit_s: f64) -> (String, f64) {
        let done_count = samples.len() as u64;
        let fraction_done = done_count as f64 / self.max_iterations as f64;
        let remaining_s =
            remaining_seconds(Some(fraction_done), elapsed, Some(limit_s)).unwrap_or(self.max_seconds);
        let (smallest, largest) = self.size_range;
        let text = format!(
            "{} of {}, {} iterations/s, upload {} at {}, {} at {}, {} left",
            count(done_count),
            count(self.max_iterations),
            number::rate(mean_rate(done_count, elapsed).unwrap_or_default()),
            describe_median(samples, smallest),
            bytes(smallest as f64).plain(),
            describe_median(samples, largest),
            bytes(largest as f64).plain(),
            estimated_duration(remaining_s),
        );
        (text, elapsed / (elapsed + remaining_s))
    }
}

/// Formats the median delay of the uploads with this payload so far.
fn describe_median(samples: &[Sample], payload_bytes: u64) -> String {
    let median = median_delay(Direction::Up, samples, payload_bytes);
    median.map_or_else(|| NONE.to_owned(), |median| format!("{} ms", milliseconds(median)))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::super::Arguments;
    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        arguments: Arguments,
    }

    #[test]
    fn time_limit_counts_from_end_of_warm_up() {
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        let line = Line::try_parse_from(["calibrate", "cloud", "--seconds", "120"]).expect("a command line");
        let plan = Plan::new(&line.arguments).expect("the default sizes");
        let quiet = true;
        let mut display = SweepDisplay::new(&plan, quiet, at(0));
        display.begin(at(5));
        assert_eq!(display.time_limit(), at(125));
        display.record_warm_up(at(70));
        assert_eq!(display.time_limit(), at(190), "the agent counts the limit in the same way");
    }
}
