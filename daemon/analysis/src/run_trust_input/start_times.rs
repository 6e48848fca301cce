//! Times at which a run's iterations started, from the run's record and rows.

use chrono::{DateTime, Utc};
use peernet_clock::WallTime;
use peernet_logger::stage;

use crate::record::RunRecord;
use crate::rows::{RowRef, Rows};
use crate::standstill::{RunExtent, standstill};
use crate::trust::{StartTimes, StartsSoFar, start_time};

impl StartTimes {
    /// Returns the start times of a run from its record and rows.
    pub fn from_run(record: &RunRecord, rows: &Rows) -> Self {
        let start = |row: RowRef<'_>| start_time(row.at());
        let rows_with_start = || rows.iter().filter(|row| !row.warm_up() && row.at() > 0.0);
        let mut starts = StartsSoFar::default();
        rows_with_start().for_each(|row| starts.add(row.iteration(), row.at()));
        let times = starts.times();
        let wall = |time: Option<DateTime<Utc>>| {
            time.and_then(|time| time.timestamp_nanos_opt()).map(WallTime::from_unix_nanos)
        };
        let slowest_s = rows.values_in_statistics(&stage::TOTAL).fold(0.0, f64::max);
        let extent = wall(record.started).or(times.first).zip(wall(record.ended).or(times.last));
        let extent = extent.map(|(started_at, end)| RunExtent {
            started: started_at,
            end,
            iterations: starts.started(),
            slowest_s,
        });
        // Missing iterations may have started during a pause between rows, which is then no standstill.
        let extent = extent.filter(|_| record.counts.unseen == 0);
        // A row has the time of one start, which is a range of length zero.
        let start_ranges = rows_with_start().map(start).map(|at| (at, at));
        Self { standstill_s: extent.and_then(|extent| standstill(&extent, start_ranges)), ..times }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::{Outcome, Row};
    use crate::testing::row_of_values;
    use crate::trust::Starts;

    /// Returns the record and the rows of a run. Each start is the number of an iteration and the seconds from a fixed
    /// time. The starts are in the order in which their iterations ended.
    fn run(starts: &[(u64, f64)]) -> (RunRecord, Rows) {
        let row = |(iteration, at): &(u64, f64)| Row {
            iteration: *iteration,
            at: 1e9 + at,
            ..row_of_values(Outcome::Ok, &[])
        };
        (RunRecord::default(), starts.iter().map(row).collect())
    }

    #[test]
    fn start_rate_spans_first_to_last_iteration() {
        let starts = |times: &[(u64, f64)], missing| {
            let (record, rows) = run(times);
            Starts { missing, times: StartTimes::from_run(&record, &rows), ..Starts::from_rows(&rows) }
        };
        let times = [(2, 10.5), (1, 10.0), (4, 12.0), (3, 11.5)];
        // The 2 s contain three periods, or five if two further iterations started.
        assert_eq!(starts(&times, Some(0)).actual_hz(), Some(1.5));
        assert_eq!(starts(&times, Some(2)).actual_hz(), Some(2.5), "missing iterations count as starts, too");
        // Four measured iterations at 2.5 Hz.
        assert_eq!(starts(&times, Some(2)).measured_seconds(), Some(1.6));
        assert_eq!(starts(&times, None).actual_hz(), None);
        assert_eq!([&[(1, 10.0)][..], &[]].map(|times| starts(times, Some(0)).actual_hz()), [None, None]);
    }

    #[test]
    fn duration_of_starts_is_unknown_after_clock_was_set() {
        let times = |set_by_s: f64| {
            let starts = (1..=1_000_u32).map(|number| {
                let correct = f64::from(number) / 10.0;
                (u64::from(number), if number > 500 { correct + set_by_s } else { correct })
            });
            let (record, rows) = run(&starts.collect::<Vec<_>>());
            (
                StartTimes::from_run(&record, &rows),
                StartTimes::from_run(&with_unseen_iteration(record), &rows),
            )
        };
        let not_set = times(0.0).0;
        assert!(not_set.seconds().is_some_and(|seconds| (seconds - 99.9).abs() < 1e-6), "{not_set:?}");
        let (forward, with_missing) = times(3_600.0);
        assert_eq!(forward.seconds(), None);
        assert!(forward.standstill_s.is_some_and(|seconds| (seconds - 3_600.1).abs() < 1e-3), "{forward:?}");
        assert_eq!(with_missing.standstill_s, None, "missing iterations may have started in the pause");
        assert_eq!(times(-3_600.0).0.seconds(), None);
    }

    fn with_unseen_iteration(mut record: RunRecord) -> RunRecord {
        record.counts.unseen = 1;
        record
    }
}
