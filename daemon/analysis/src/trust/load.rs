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

/// Numbers of actual and of skipped starts, without the warm-up, and the rates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Starts {
    /// Configured starts per second; `None` in a closed loop, and if the rate is not known.
    pub hz: Option<f64>,
    /// Number of iterations that started.
    pub started: u64,
    /// Number of starts that were skipped because the pipeline was too far behind.
    pub skipped: u64,
    /// Actual starts per second from the first to the last start, of answered and unanswered iterations; `None` if their times are not known.
    pub actual_hz: Option<f64>,
}

impl Starts {
    /// Returns the starts of these rows. The configured rate is `None`, because rows do not contain it.
    pub fn from_rows(rows: &Rows) -> Self {
        let started = || rows.iter().filter(|row| !row.warm_up());
        let skipped = started().filter_map(|row| row.value(SKIPPED_STARTS)).filter(|value| *value > 0.0);
        Self {
            hz: None,
            started: started().count() as u64,
            skipped: skipped.sum::<f64>() as u64,
            actual_hz: rate_of_starts(started().map(|row| row.at()).filter(|at| *at > 0.0)),
        }
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

/// Returns the starts per second of `count` iterations; their first and last start are `seconds` apart. `None` with fewer than two starts.
pub fn start_rate(count: u64, seconds: f64) -> Option<f64> {
    (count > 1 && seconds > 0.0).then(|| (count - 1) as f64 / seconds)
}

/// Returns the starts per second. The starts are in the order in which their iterations ended, so an earlier start can follow a later one.
fn rate_of_starts(starts: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, first, last) = starts
        .fold((0, f64::INFINITY, 0.0), |(count, first, last): (u64, f64, f64), at| {
            (count + 1, first.min(at), last.max(at))
        });
    start_rate(count, last - first)
}

#[cfg(test)]
mod tests {
    use super::rate_of_starts;

    #[test]
    fn start_rate_spans_first_to_last_start() {
        assert_eq!(rate_of_starts([10.5, 10.0, 11.5, 12.0].into_iter()), Some(1.5));
        assert_eq!([rate_of_starts([10.0].into_iter()), rate_of_starts(std::iter::empty())], [None, None]);
    }
}
