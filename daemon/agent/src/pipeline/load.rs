//! The schedule of a pipeline's starts. No I/O: the time is an argument.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};
use peernet_statistics::SplitMix64;

use crate::config::LoadConfig;

/// Schedule of a pipeline's starts.
///
/// With a rate the schedule does not wait for the pipeline: starts come due while earlier iterations are in flight. The
/// latency of an iteration that starts late counts from its intended start. A stall therefore shows in the latencies of
/// all iterations that waited through it (this avoids coordinated omission). The number of due starts is limited:
/// beyond the limit the oldest are skipped, and the next start carries their count.
#[derive(Debug)]
pub(crate) struct Schedule {
    plan: StartPlan,
    /// Starts that have come due and were not taken yet, oldest first.
    due: VecDeque<MonoTime>,
    /// Maximum number of starts in `due`.
    max_due: usize,
    /// Number of starts that were skipped since the latest start was taken.
    skipped: u64,
}

/// Times at which starts come due; a closed loop has none.
#[derive(Debug)]
enum StartPlan {
    Closed,
    Rate { origin: MonoTime, period_nanos: f64, next_number: u64 },
    Poisson { next_at: MonoTime, mean_nanos: f64, random: SplitMix64 },
}

/// The start of one iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Start {
    /// Time at which the iteration should start.
    pub(crate) intended: MonoTime,
    /// Number of starts that were skipped between the previous start and this start.
    pub(crate) skipped: u64,
}

impl Schedule {
    /// Creates a schedule whose first start is at or after `now`; at most `max_due` starts wait.
    pub(crate) fn new(load: &LoadConfig, max_due: usize, now: MonoTime) -> Self {
        let plan = match *load {
            LoadConfig::Closed {} => StartPlan::Closed,
            LoadConfig::Rate { hz } => {
                StartPlan::Rate { origin: now, period_nanos: 1e9 / hz, next_number: 0 }
            }
            LoadConfig::Poisson { hz, seed } => {
                let mut random = SplitMix64::new(seed);
                let mean_nanos = 1e9 / hz;
                // In a Poisson process the time to the first start is an interval like the others.
                StartPlan::Poisson {
                    next_at: now + random_interval(mean_nanos, &mut random),
                    mean_nanos,
                    random,
                }
            }
        };
        Self { plan, due: VecDeque::new(), max_due, skipped: 0 }
    }

    /// Returns whether the loop is closed: the next iteration starts when the last one is complete.
    pub(crate) const fn is_closed(&self) -> bool {
        matches!(self.plan, StartPlan::Closed)
    }

    /// Takes the next start if a start is due. In a closed loop a start is always due, because the caller waits for
    /// each answer.
    pub(crate) fn take(&mut self, now: MonoTime) -> Option<Start> {
        if self.is_closed() {
            return Some(Start { intended: now, skipped: 0 });
        }
        self.catch_up(now);
        let intended = self.due.pop_front()?;
        Some(Start { intended, skipped: std::mem::take(&mut self.skipped) })
    }

    /// Restarts the schedule at `now`, as if it were created now. The waiting starts are dropped: they are neither
    /// returned nor counted as skipped.
    pub(crate) fn resume_at(&mut self, now: MonoTime) {
        self.due.clear();
        match &mut self.plan {
            StartPlan::Closed => {}
            StartPlan::Rate { origin, next_number, .. } => (*origin, *next_number) = (now, 0),
            StartPlan::Poisson { next_at, mean_nanos, random } => {
                *next_at = now + random_interval(*mean_nanos, random);
            }
        }
    }

    /// Skips the starts that have come due by `now` and were not taken.
    pub(crate) fn skip_due(&mut self, now: MonoTime) {
        self.catch_up(now);
        self.skipped += self.due.len() as u64;
        self.due.clear();
    }

    /// Postpones all further starts by `pause`. The caller must have taken or skipped the starts that came due before
    /// the pause.
    pub(crate) fn postpone(&mut self, pause: Span) {
        match &mut self.plan {
            StartPlan::Closed => {}
            StartPlan::Rate { origin, .. } => *origin = *origin + pause,
            StartPlan::Poisson { next_at, .. } => *next_at = *next_at + pause,
        }
    }

    /// Returns the number of starts that were skipped since the latest start was taken.
    pub(crate) const fn unreported_skips(&self) -> u64 {
        self.skipped
    }

    /// Returns the intended start of the next iteration: in the past if it is late, `now` in a closed loop.
    pub(crate) fn next_at(&mut self, now: MonoTime) -> MonoTime {
        self.catch_up(now);
        self.due.front().copied().or_else(|| self.plan.next_at()).unwrap_or(now)
    }

    /// Moves the starts that have come due by `now` to the queue of due starts. A caller that takes no start for a long
    /// time should call this method periodically, so that each call is short.
    pub(crate) fn catch_up(&mut self, now: MonoTime) {
        while let Some(at) = self.plan.next_at().filter(|at| *at <= now) {
            self.plan.advance();
            self.due.push_back(at);
            // The oldest start is skipped, because its iteration would be the most outdated.
            if self.due.len() > self.max_due {
                self.due.pop_front();
                self.skipped += 1;
            }
        }
    }
}

impl StartPlan {
    /// Returns the time at which the next start comes due; `None` in a closed loop.
    fn next_at(&self) -> Option<MonoTime> {
        match self {
            Self::Closed => None,
            // Computed from the origin each time, so that rounding errors do not add up.
            Self::Rate { origin, period_nanos, next_number } => {
                Some(*origin + Span::from_nanos((*period_nanos * *next_number as f64).round() as i64))
            }
            Self::Poisson { next_at, .. } => Some(*next_at),
        }
    }

    /// Moves on to the start after the next one.
    fn advance(&mut self) {
        match self {
            Self::Closed => {}
            Self::Rate { next_number, .. } => *next_number += 1,
            Self::Poisson { next_at, mean_nanos, random } => {
                *next_at = *next_at + random_interval(*mean_nanos, random);
            }
        }
    }
}

/// Returns a random, exponentially distributed interval. It is at least a nanosecond,
/// so that the schedule always advances.
fn random_interval(mean_nanos: f64, random: &mut SplitMix64) -> Span {
    Span::from_nanos(((mean_nanos * random.exponential()).round() as i64).max(1))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::from_nanos(millis * 1_000_000)
    }

    fn ten_hertz_schedule(max_due: usize) -> Schedule {
        Schedule::new(&LoadConfig::Rate { hz: 10.0 }, max_due, at(0))
    }

    #[test]
    fn closed_loop_starts_on_request() {
        let mut schedule = Schedule::new(&LoadConfig::Closed {}, 4, at(0));
        assert_eq!(schedule.next_at(at(6)), at(6));
        assert_eq!(schedule.take(at(7)), Some(Start { intended: at(7), skipped: 0 }));
        assert_eq!(schedule.take(at(7)), Some(Start { intended: at(7), skipped: 0 }));
    }

    #[test]
    fn rate_keeps_its_schedule_after_late_request() {
        let mut schedule = ten_hertz_schedule(4);
        assert_eq!(schedule.take(at(3)), Some(Start { intended: at(0), skipped: 0 }));
        assert_eq!(schedule.take(at(99)), None);
        assert_eq!(schedule.next_at(at(99)), at(100));
        assert_eq!(schedule.take(at(150)), Some(Start { intended: at(100), skipped: 0 }));
        assert_eq!(schedule.next_at(at(150)), at(200));
    }

    #[test]
    fn stall_keeps_latest_starts_and_counts_skipped_ones() {
        let mut schedule = ten_hertz_schedule(2);
        // The starts at 0, 100, …, 900 ms have come due. Two of them may wait, and eight are skipped.
        assert_eq!(schedule.take(at(950)), Some(Start { intended: at(800), skipped: 8 }));
        assert_eq!(schedule.take(at(951)), Some(Start { intended: at(900), skipped: 0 }));
        assert_eq!(schedule.take(at(952)), None);
        assert_eq!(schedule.take(at(1000)), Some(Start { intended: at(1000), skipped: 0 }));
    }

    #[test]
    fn starts_before_resumption_are_neither_returned_nor_counted() {
        let mut schedule = ten_hertz_schedule(2);
        assert_eq!(schedule.take(at(350)), Some(Start { intended: at(200), skipped: 2 }));
        schedule.resume_at(at(5040));
        assert_eq!(schedule.take(at(5041)), Some(Start { intended: at(5040), skipped: 0 }));
        assert_eq!(schedule.next_at(at(5050)), at(5140));
        let mut poisson = Schedule::new(&LoadConfig::Poisson { hz: 10.0, seed: 1 }, 2, at(0));
        poisson.resume_at(at(5040));
        assert!(poisson.next_at(at(5040)) > at(5040), "a new interval precedes the first start");
    }

    #[test]
    fn only_starts_before_pause_are_counted_as_skipped() {
        let mut schedule = ten_hertz_schedule(4);
        assert_eq!(schedule.take(at(0)), Some(Start { intended: at(0), skipped: 0 }));
        schedule.skip_due(at(250));
        schedule.postpone(Span::from_millis(1000));
        assert_eq!(schedule.take(at(1299)), None);
        assert_eq!(schedule.take(at(1300)), Some(Start { intended: at(1300), skipped: 2 }));
        let mut poisson = Schedule::new(&LoadConfig::Poisson { hz: 10.0, seed: 1 }, 2, at(0));
        let next = poisson.next_at(at(0));
        poisson.postpone(Span::from_millis(1000));
        assert_eq!(poisson.next_at(at(0)), next + Span::from_millis(1000));
    }

    #[test]
    fn equal_seeds_give_equal_starts_at_mean_rate() {
        let starts = |seed| {
            let mut schedule = Schedule::new(&LoadConfig::Poisson { hz: 100.0, seed }, 1, at(0));
            (0..2000)
                .map(|_| {
                    let next = schedule.next_at(at(0));
                    schedule.take(next).expect("due").intended
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(starts(1), starts(1));
        assert_ne!(starts(1), starts(2));
        let mean = (starts(1)[1999] - at(0)).seconds() / 2000.0;
        assert!((mean - 0.01).abs() < 0.001, "{mean}");
    }

    proptest! {
        /// Each start is taken, skipped or still waiting, no matter at which times the starts are taken.
        #[test]
        fn every_start_is_returned_or_counted_as_skipped(
            hz in 0.5..500.0f64,
            max_due in 1usize..6,
            waits in prop::collection::vec(0i64..2000, 1..40),
        ) {
            let mut schedule = Schedule::new(&LoadConfig::Rate { hz }, max_due, at(0));
            let (mut now, mut taken_or_skipped, mut latest) = (0, 0u64, None);
            for wait in waits {
                now += wait;
                if let Some(start) = schedule.take(at(now)) {
                    prop_assert!(start.intended <= at(now));
                    prop_assert!(latest < Some(start.intended));
                    latest = Some(start.intended);
                    taken_or_skipped += 1 + start.skipped;
                }
            }
            schedule.catch_up(at(now));
            let waiting = schedule.due.len() as u64;
            prop_assert!(waiting <= max_due as u64);
            let planned = (0u64..).take_while(|k| (*k as f64 * 1e9 / hz).round() as i64 <= now * 1_000_000);
            prop_assert_eq!(taken_or_skipped + waiting + schedule.skipped, planned.count() as u64);
        }
    }
}
