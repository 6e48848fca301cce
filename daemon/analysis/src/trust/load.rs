//! Starts of iterations in an open loop.

use peernet_clock::WallTime;
use peernet_statistics::mean_rate;
use peernet_statistics::number::{SPACE, count, counted, percent};
use serde::Deserialize;

use crate::rows::{Rows, SKIPPED_STARTS};

/// Configured rate of a run's starts: the table `load` of its pipeline.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct Load {
    /// Starts per second, on average if they are random; `None` in a closed loop, which waits for each answer.
    pub hz: Option<f64>,
}

/// Numbers and times of actual starts, and number of skipped starts, without the warm-up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Starts {
    /// Configured starts per second; `None` in a closed loop, or if the rate is not known.
    pub hz: Option<f64>,
    /// Number of iterations that started and whose measurements are not missing.
    pub started: u64,
    /// Number of further iterations that started, but whose measurements are missing; `None` if this number is not
    /// known.
    pub missing: Option<u64>,
    /// Number of starts that were skipped because the pipeline was too far behind.
    pub skipped: u64,
    /// Times of the starts, of successful and failed iterations.
    pub times: StartTimes,
}

/// Times of the starts of a run, without the warm-up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StartTimes {
    /// Start of the iteration with the smallest number; `None` if it is not known.
    pub first: Option<WallTime>,
    /// Start of the iteration with the largest number; `None` if it is not known.
    pub last: Option<WallTime>,
    /// Length of a [standstill](crate::standstill), seconds; `None` without one.
    pub standstill_s: Option<f64>,
}

/// Starts of the iterations that have ended so far, without the warm-up.
#[derive(Clone, Copy, Debug, Default)]
pub struct StartsSoFar {
    started: u64,
    /// Number and start of the iteration with the smallest number.
    first: Option<(u64, WallTime)>,
    /// Number and start of the iteration with the largest number.
    last: Option<(u64, WallTime)>,
}

impl StartsSoFar {
    /// Adds the start of an iteration, seconds of Unix time. Iterations may be added in any order.
    pub fn add(&mut self, iteration: u64, at: f64) {
        let start = (iteration, start_time(at));
        self.started += 1;
        self.first = Some(self.first.unwrap_or(start).min(start));
        self.last = self.last.max(Some(start));
    }

    /// Returns the starts of a run that misses no iteration.
    pub fn starts(&self) -> Starts {
        Starts { started: self.started, missing: Some(0), times: self.times(), ..Starts::default() }
    }

    /// Returns the number of starts.
    pub fn started(&self) -> u64 {
        self.started
    }

    /// Returns the times of the first and the last start. A standstill is not looked for.
    pub fn times(&self) -> StartTimes {
        let [first, last] = [self.first, self.last].map(|start| start.map(|(_, at)| at));
        StartTimes { first, last, standstill_s: None }
    }
}

impl Starts {
    /// Returns the starts of these rows. The configured rate is `None`, because rows do not contain this rate. No
    /// measurements count as missing. The times are unknown: [`StartTimes::from_run`] reads them.
    pub fn from_rows(rows: &Rows) -> Self {
        let started = || rows.iter().filter(|row| !row.warm_up());
        let skipped = started().filter_map(|row| row.value(SKIPPED_STARTS)).filter(|value| *value > 0.0);
        Self {
            hz: None,
            started: started().count() as u64,
            missing: Some(0),
            skipped: skipped.sum::<f64>() as u64,
            times: StartTimes::default(),
        }
    }

    /// Returns the numbers of actual and of skipped starts of several runs together. The rate, the missing starts and
    /// the times are unknown, because each run has its own.
    pub fn sum(runs: impl IntoIterator<Item = Self>) -> Self {
        runs.into_iter().fold(Self::default(), |all, run| Self {
            started: all.started + run.started,
            skipped: all.skipped.saturating_add(run.skipped),
            ..all
        })
    }

    /// Returns the actual starts per second of all iterations, including those in `missing`. `None` with fewer than two
    /// starts, or if the number or the times of the starts are not known.
    pub fn actual_hz(&self) -> Option<f64> {
        let started = self.started.saturating_add(self.missing?);
        // The time from the first to the last start contains one period less than there are starts.
        mean_rate(started.saturating_sub(1), self.times.seconds()?)
    }

    /// Returns the part of the run's time that belongs to the iterations in `started`, seconds: their number divided by
    /// the rate of all iterations. `None` if the rate is not known.
    pub fn measured_seconds(&self) -> Option<f64> {
        Some(self.started as f64 / self.actual_hz()?)
    }

    /// Returns the number of scheduled starts: the starts that took place and the starts that were skipped.
    pub const fn total(&self) -> u64 {
        // A column of a file can contain any number of skipped starts.
        self.started.saturating_add(self.skipped)
    }

    /// Returns the text on skipped starts, such as `101 of 202 starts (50 %)`; `None` if no start was skipped.
    pub fn skipped_text(&self) -> Option<String> {
        let share = percent(self.skipped_share());
        let skipped_text =
            format!("{} of {} ({share}{SPACE}%)", count(self.skipped), counted(self.total(), "start"));
        (self.skipped > 0).then_some(skipped_text)
    }

    /// Returns the share of starts that were skipped, 0 to 1.
    pub fn skipped_share(&self) -> f64 {
        if self.total() == 0 { 0.0 } else { self.skipped as f64 / self.total() as f64 }
    }
}

impl StartTimes {
    /// Returns the time from the first to the last start, seconds. `None` if the first or the last start is not known,
    /// if there was a standstill, or if the last start lies before the first, because the wall clock was set back.
    pub fn seconds(&self) -> Option<f64> {
        let seconds = (self.last? - self.first?).seconds();
        (self.standstill_s.is_none() && seconds >= 0.0).then_some(seconds)
    }
}

/// Returns the time of a start from the column `at`.
pub(crate) fn start_time(at: f64) -> WallTime {
    WallTime::from_unix_nanos((at * 1e9) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_start_is_that_of_smallest_number() {
        let mut starts = StartsSoFar::default();
        // The clock was set back by 60 s after the second start.
        for (iteration, at) in [(2, 110.0), (1, 100.0), (4, 70.0), (3, 60.0)] {
            starts.add(iteration, at);
        }
        let wall = |seconds: i64| Some(WallTime::from_unix_nanos(seconds * 1_000_000_000));
        let times = starts.starts().times;
        assert_eq!([times.first, times.last], [wall(100), wall(70)]);
        assert_eq!(starts.starts().actual_hz(), None);
    }
}
