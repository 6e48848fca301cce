//! Progress of the sweep.

use peernet_analysis::calibration::{Sample, median_delay};
use peernet_clock::{Direction, MonoTime};
use peernet_statistics::number::{self, NONE, bytes, count, milliseconds};
use peernet_statistics::{mean_rate, remaining_seconds};

use super::plan::Plan;
use crate::foreground::{Progress, estimated_duration};

/// Display of the sweep's progress.
pub(super) struct SweepDisplay {
    progress: Progress,
    limits: SweepLimits,
    started_at: MonoTime,
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
        Self { progress: Progress::new(quiet, now), limits, started_at: now }
    }

    /// Records the start of the first iteration.
    pub(super) const fn begin(&mut self, now: MonoTime) {
        self.started_at = now;
    }

    /// Shows the state at `now`. If there is `trouble`, it replaces the state.
    pub(super) fn show(&mut self, samples: &[Sample], now: MonoTime, trouble: Option<String>) {
        let (limits, elapsed) = (&self.limits, (now - self.started_at).seconds());
        self.progress.show(now, trouble, || limits.describe(samples, elapsed));
    }

    /// Removes the bar.
    pub(super) fn end(&self) {
        self.progress.end();
    }
}

impl SweepLimits {
    /// Describes the state. Also returns the fraction of the sweep that is done, from 0 to 1.
    fn describe(&self, samples: &[Sample], elapsed: f64) -> (String, f64) {
        let done_count = samples.len() as u64;
        // The sweep ends at the limit that it reaches first, so the larger fraction counts.
        let fraction_done =
            (done_count as f64 / self.max_iterations as f64).max(elapsed / self.max_seconds).clamp(0.0, 1.0);
        let remaining_s = remaining_seconds(fraction_done, elapsed).unwrap_or(self.max_seconds);
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
        (text, fraction_done)
    }
}

/// Formats the median delay of the uploads with this payload so far.
fn describe_median(samples: &[Sample], payload_bytes: u64) -> String {
    let median = median_delay(Direction::Up, samples, payload_bytes);
    median.map_or_else(|| NONE.to_owned(), |median| format!("{} ms", milliseconds(median)))
}
