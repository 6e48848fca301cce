//! Starts of iterations in an open loop.

use chrono::{DateTime, Utc};
use peernet_clock::WallTime;
use peernet_logger::stage;
use peernet_statistics::number::{counted, fixed, percent};
use serde::Deserialize;

use crate::record::RunRecord;
use crate::rows::{RowRef, Rows, SKIPPED_STARTS};
use crate::standstill::{RunExtent, standstill};

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
    /// Times of the starts, of answered and unanswered iterations.
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

impl Starts {
    /// Returns the starts of these rows. The configured rate is `None`, because rows do not contain it, and no measurements are missing.
    /// The times are unknown: [`StartTimes::from_run`] reads them.
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

    /// Returns the actual starts per second, of all iterations that started; `None` with fewer than two starts, and if their number or their time
    /// is not known.
    pub fn actual_hz(&self) -> Option<f64> {
        let started = self.started.saturating_add(self.missing?);
        let seconds = self.times.seconds().filter(|seconds| *seconds > 0.0)?;
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

impl StartTimes {
    /// Returns the times of these rows and their record.
    pub fn from_run(record: &RunRecord, rows: &Rows) -> Self {
        let start = |row: RowRef<'_>| WallTime::from_unix_nanos((row.at() * 1e9) as i64);
        let started = || rows.iter().filter(|row| !row.warm_up() && row.at() > 0.0);
        // Rows are in the order in which their iterations ended, so an earlier start can follow a later one.
        let first = started().min_by_key(|row| row.iteration()).map(start);
        let last = started().max_by_key(|row| row.iteration()).map(start);
        let wall = |time: Option<DateTime<Utc>>| {
            time.and_then(|time| time.timestamp_nanos_opt()).map(WallTime::from_unix_nanos)
        };
        let slowest_s = rows.counted_values(&stage::TOTAL).fold(0.0, f64::max);
        let extent = wall(record.started).or(first).zip(wall(record.ended).or(last));
        let extent = extent.map(|(started_at, end)| RunExtent {
            started: started_at,
            end,
            iterations: started().count() as u64,
            slowest_s,
        });
        // Missing iterations may have started meanwhile.
        let extent = extent.filter(|_| record.counts.unseen == 0);
        let busy = started().map(start).map(|at| (at, at));
        Self { first, last, standstill_s: extent.and_then(|extent| standstill(&extent, busy)) }
    }

    /// Returns the time from the first to the last start, seconds. `None` if it is not known: also with a standstill, and if the last start is
    /// before the first one, because the wall clock was set back.
    pub fn seconds(&self) -> Option<f64> {
        let seconds = (self.last? - self.first?).seconds();
        (self.standstill_s.is_none() && seconds >= 0.0).then_some(seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::{Outcome, Row};
    use crate::testing::row_of_values;

    /// Returns the record and the rows of a run with these starts, seconds after its begin, in the order of the end of their iterations.
    fn run(starts: &[(u64, f64)]) -> (RunRecord, Rows) {
        let row = |(iteration, at): &(u64, f64)| Row {
            iteration: *iteration,
            at: 1e9 + at,
            ..row_of_values(Outcome::Ok, &[])
        };
        (RunRecord::default(), starts.iter().map(row).collect())
    }

    #[test]
    fn start_rate_spans_first_to_last_number() {
        let starts = |times: &[(u64, f64)], missing| {
            let (record, rows) = run(times);
            Starts { missing, times: StartTimes::from_run(&record, &rows), ..Starts::from_rows(&rows) }
        };
        let times = [(2, 10.5), (1, 10.0), (4, 12.0), (3, 11.5)];
        assert_eq!(starts(&times, Some(0)).actual_hz(), Some(1.5));
        assert_eq!(starts(&times, Some(2)).actual_hz(), Some(2.5), "missing iterations were started, too");
        assert_eq!(starts(&times, None).actual_hz(), None);
        assert_eq!([&[(1, 10.0)][..], &[]].map(|times| starts(times, Some(0)).actual_hz()), [None, None]);
    }

    #[test]
    fn time_of_starts_is_unknown_after_clock_was_set() {
        let times = |set_by_s: f64| {
            let starts = (1..=1_000_u32).map(|number| {
                let correct = f64::from(number) / 10.0;
                (u64::from(number), if number > 500 { correct + set_by_s } else { correct })
            });
            let (record, rows) = run(&starts.collect::<Vec<_>>());
            (StartTimes::from_run(&record, &rows), StartTimes::from_run(&unseen(record), &rows))
        };
        let unset = times(0.0).0;
        assert!(unset.seconds().is_some_and(|seconds| (seconds - 99.9).abs() < 1e-6), "{unset:?}");
        let (forward, with_missing) = times(3_600.0);
        assert_eq!(forward.seconds(), None);
        assert!(forward.standstill_s.is_some_and(|seconds| (seconds - 3_600.1).abs() < 1e-3), "{forward:?}");
        assert_eq!(with_missing.standstill_s, None, "missing iterations may have started meanwhile");
        assert_eq!(times(-3_600.0).0.seconds(), None);
    }

    fn unseen(mut record: RunRecord) -> RunRecord {
        record.counts.unseen = 1;
        record
    }
}
