//! Starts of iterations in an open loop.

use peernet_statistics::number::{counted, fixed, percent};
use serde::Deserialize;

use crate::rows::{Rows, SKIPPED_STARTS};

/// Configured rate of starts of a run: the `load` of its pipeline.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct Load {
    /// Starts per second, on average if they are random; `None` in a closed loop, which waits for each answer.
    pub hz: Option<f64>,
}

/// Numbers of actual and of skipped starts, without the warm-up, and their time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Starts {
    /// Configured starts per second; `None` in a closed loop, and if the rate is not known.
    pub hz: Option<f64>,
    /// Number of iterations that started, without those in `missing`.
    pub started: u64,
    /// Number of iterations that started and whose measurements are missing; `None` if it is not known.
    pub missing: Option<u64>,
    /// Number of starts that were skipped because the pipeline was too far behind.
    pub skipped: u64,
    /// Time from the first to the last start, of answered and unanswered iterations; `None` if it is not known.
    pub seconds: Option<f64>,
}

impl Starts {
    /// Returns the starts of these rows. The configured rate is `None`, because rows do not contain it, and no measurements are missing.
    pub fn from_rows(rows: &Rows) -> Self {
        let started = || rows.iter().filter(|row| !row.warm_up());
        let skipped = started().filter_map(|row| row.value(SKIPPED_STARTS)).filter(|value| *value > 0.0);
        Self {
            hz: None,
            started: started().count() as u64,
            missing: Some(0),
            skipped: skipped.sum::<f64>() as u64,
            seconds: seconds_between(started().map(|row| row.at()).filter(|at| *at > 0.0)),
        }
    }

    /// Returns the actual starts per second, of all iterations that started; `None` with fewer than two starts, and if their number or their time
    /// is not known.
    pub fn actual_hz(&self) -> Option<f64> {
        let started = self.started.saturating_add(self.missing?);
        let seconds = self.seconds.filter(|seconds| *seconds > 0.0)?;
        (started > 1).then(|| (started - 1) as f64 / seconds)
    }

    /// Returns the number of all starts that were due.
    pub const fn total(&self) -> u64 {
        self.started + self.skipped
    }

    /// Returns the text on skipped starts, such as `101 of 202 starts (50 %)`; `None` if no start was skipped.
    pub fn skipped_text(&self) -> Option<String> {
        let share = percent(self.skipped_share());
        let skipped_text =
            format!("{} of {} ({share} %)", fixed(self.skipped as f64, 0), counted(self.total(), "start"));
        (self.skipped > 0).then_some(skipped_text)
    }

    /// Returns the share of starts that were skipped, 0 to 1.
    pub fn skipped_share(&self) -> f64 {
        if self.total() == 0 { 0.0 } else { self.skipped as f64 / self.total() as f64 }
    }
}

/// Returns the time from the first to the last start, seconds. The starts are in the order in which their iterations ended, so an earlier start
/// can follow a later one.
fn seconds_between(starts: impl Iterator<Item = f64>) -> Option<f64> {
    let ends = starts.map(|at| (at, at)).reduce(|(first, last), (at, _)| (first.min(at), last.max(at)));
    ends.map(|(first, last)| last - first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn start_rate_spans_first_to_last_start() {
        let starts = |times: &[f64], missing| Starts {
            started: times.len() as u64,
            missing,
            seconds: seconds_between(times.iter().copied()),
            ..Starts::default()
        };
        let times = [10.5, 10.0, 11.5, 12.0];
        assert_eq!(starts(&times, Some(0)).actual_hz(), Some(1.5));
        assert_eq!(starts(&times, Some(2)).actual_hz(), Some(2.5), "missing iterations were started, too");
        assert_eq!(starts(&times, None).actual_hz(), None);
        assert_eq!([&[10.0][..], &[]].map(|times| starts(times, Some(0)).actual_hz()), [None, None]);
    }
}
