//! A clock with injected faults.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::clock_faults::{ClockFaults, SteppedClock};
use crate::{Clock, ClockIdentity, MonoTime, RawTime, Readings, SharedClock, Span, WallTime};

/// A clock whose wall clock and free-running clock have injected faults. Its monotonic clock is unchanged.
#[derive(Debug)]
pub struct FaultyClock {
    inner: SharedClock,
    identity: ClockIdentity,
    faults: ClockFaults,
    /// Time that the inner free-running clock showed when the faults started.
    raw_since: RawTime,
    step_counts: Mutex<StepCounts>,
}

/// Wall epoch of the inner clock, number of injected steps, and size of the last step, as of the last query.
#[derive(Debug, Default)]
struct StepCounts {
    inner_wall_epoch: u32,
    injected_steps: u32,
    last_step: Option<Span>,
}

impl FaultyClock {
    /// Creates a clock that shows `inner` with `faults`.
    pub fn new(inner: SharedClock, identity: ClockIdentity, faults: ClockFaults) -> Self {
        let step_counts =
            Mutex::new(StepCounts { inner_wall_epoch: inner.wall_epoch(), ..StepCounts::default() });
        let now = inner.stamp();
        // Faults start at the same moment on both clocks.
        let raw_since = now.raw - (now.wall - faults.since);
        Self { inner, identity, faults, raw_since, step_counts }
    }

    /// Updates and returns the numbers of steps. An injected step counts as soon as its time has come.
    fn update_step_counts(&self) -> MutexGuard<'_, StepCounts> {
        let mut step_counts = self.step_counts.lock().unwrap_or_else(PoisonError::into_inner);
        let inner_wall_epoch = self.inner.wall_epoch();
        let elapsed = self.inner.wall() - self.faults.since;
        let steps = || self.faults.steps_within(elapsed, SteppedClock::Wall);
        let due_steps = steps().count() as u32;
        if inner_wall_epoch > step_counts.inner_wall_epoch {
            step_counts.inner_wall_epoch = inner_wall_epoch;
            step_counts.last_step = self.inner.last_step();
        }
        if due_steps > step_counts.injected_steps {
            step_counts.injected_steps = due_steps;
            step_counts.last_step = steps().max_by_key(|step| step.at).map(|step| step.by);
        }
        step_counts
    }
}

impl Clock for FaultyClock {
    fn wall(&self) -> WallTime {
        self.faults.shown_wall(self.inner.wall())
    }

    fn mono(&self) -> MonoTime {
        self.inner.mono()
    }

    fn raw(&self) -> RawTime {
        self.faults.shown_raw(self.inner.raw(), self.raw_since)
    }

    fn identity(&self) -> &ClockIdentity {
        &self.identity
    }

    fn readings(&self) -> Readings {
        let inner = self.inner.readings();
        let wall = self.faults.shown_wall(inner.wall);
        Readings { wall, raw: self.faults.shown_raw(inner.raw, self.raw_since), ..inner }
    }

    fn epoch(&self) -> u32 {
        self.inner.epoch()
    }

    fn begin_epoch(&self) {
        self.inner.begin_epoch();
    }

    fn wall_epoch(&self) -> u32 {
        let step_counts = self.update_step_counts();
        step_counts.inner_wall_epoch + step_counts.injected_steps
    }

    fn begin_wall_epoch(&self) {
        self.inner.begin_wall_epoch();
    }

    fn last_step(&self) -> Option<Span> {
        self.update_step_counts().last_step
    }

    fn apply_faults(&self, system: WallTime) -> WallTime {
        self.faults.shown_wall(system)
    }

    fn injected_faults(&self) -> Option<&ClockFaults> {
        Some(&self.faults)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::*;
    use crate::{ClockFaultStep, Interval, ManualClock};

    fn step(at: i64, by: i64) -> ClockFaultStep {
        ClockFaultStep { at: Span::from_seconds(at), by: Span::from_millis(by), clock: SteppedClock::Wall }
    }

    fn faults_with(steps: &[ClockFaultStep]) -> ClockFaults {
        ClockFaults {
            offset: Span::from_millis(137),
            drift_ppm: 50.0,
            steps: steps.to_vec(),
            since: WallTime::from_unix_nanos(1_000_000_000_000),
        }
    }

    #[test]
    fn fault_adds_offset_drift_and_due_steps() {
        let faults = faults_with(&[step(20, -500), step(10, 3000)]);
        let error = |seconds| faults.wall_error_at(faults.since + Span::from_seconds(seconds));
        assert_eq!(error(0), Span::from_millis(137));
        assert_eq!(error(2), Span::from_micros(137_100));
        assert_eq!(error(-2), Span::from_micros(136_900));
        assert_eq!(error(10), Span::from_micros(3_137_500));
        assert_eq!(error(20), Span::from_micros(2_638_000));
    }

    #[test]
    fn injected_and_real_steps_are_counted_at_first_query() {
        let faults = faults_with(&[step(20, -500), step(10, 3000)]);
        let inner = Arc::new(ManualClock::new(faults.since, ClockIdentity::new("boot", "system")));
        let clock = FaultyClock::new(inner.clone(), ClockIdentity::new("boot", "faulty"), faults);
        assert_eq!((clock.wall_epoch(), clock.last_step()), (0, None));
        inner.advance(Span::from_seconds(10));
        assert_eq!((clock.wall_epoch(), clock.last_step()), (1, Some(Span::from_seconds(3))));
        inner.step_wall(Span::from_millis(-20));
        assert_eq!((clock.wall_epoch(), clock.last_step()), (2, Some(Span::from_millis(-20))));
        clock.begin_wall_epoch();
        inner.advance(Span::from_seconds(11));
        assert_eq!((clock.wall_epoch(), clock.last_step()), (4, Some(Span::from_millis(-500))));
        assert_eq!(clock.readings().wall, clock.wall());
        assert_eq!(clock.apply_faults(inner.wall()), clock.wall());
        assert_eq!(clock.mono(), inner.mono());
        assert!(clock.injected_faults().is_some());
    }

    #[test]
    fn drift_affects_both_clocks_but_step_only_one() {
        let raw_step = ClockFaultStep { clock: SteppedClock::Raw, ..step(20, -39) };
        let faults = faults_with(&[step(10, 3000), raw_step]);
        let inner = Arc::new(ManualClock::new(faults.since, ClockIdentity::new("boot", "system")));
        let clock = FaultyClock::new(inner.clone(), ClockIdentity::new("boot", "faulty"), faults);
        let errors = || (clock.wall() - inner.wall(), clock.raw() - inner.raw());
        assert_eq!(errors(), (Span::from_millis(137), Span::from_millis(137)));
        inner.advance(Span::from_seconds(10));
        assert_eq!(errors(), (Span::from_micros(3_137_500), Span::from_micros(137_500)));
        inner.advance(Span::from_seconds(10));
        assert_eq!(errors(), (Span::from_micros(3_138_000), Span::from_micros(99_000)));
        assert_eq!(
            (clock.epoch(), clock.wall_epoch()),
            (0, 1),
            "the step of the free-running clock is not detected"
        );
        assert_eq!(
            clock.wall_ahead(),
            Interval::exactly(clock.wall() - WallTime::from_unix_nanos(clock.raw().nanos()))
        );
    }

    proptest! {
        #[test]
        fn true_time_is_recovered_from_shown_time(elapsed in 0i64..100_000_000_000, ppm in -500.0..500.0f64, by in 0i64..5000) {
            let faults = ClockFaults { drift_ppm: ppm, ..faults_with(&[step(60, 10), step(30, by)]) };
            let truth = faults.since + Span::from_nanos(elapsed);
            let recovered = faults.true_wall(faults.shown_wall(truth));
            prop_assert!((recovered - truth).abs() <= Span::from_nanos(1), "{}", recovered - truth);
        }

        #[test]
        fn time_shown_twice_maps_to_later_true_time(elapsed in 0i64..60_000_000_000) {
            let faults = faults_with(&[step(30, -10)]);
            let truth = faults.since + Span::from_nanos(elapsed);
            let recovered = faults.true_wall(faults.shown_wall(truth));
            let is_before_step = elapsed < 30_000_000_000;
            let is_shown_twice = is_before_step && elapsed + 10_000_000 >= 30_000_000_000;
            let later = truth + Span::from_millis(if is_shown_twice { 10 } else { 0 });
            // In 10 ms the clock drifts by 0.5 µs, by which `later` is inexact.
            prop_assert!((recovered - later).abs() <= Span::from_nanos(1000), "{}", recovered - later);
        }
    }

    #[test]
    fn skipped_time_maps_to_step() {
        let faults = faults_with(&[step(30, 10)]);
        let start = faults.since + Span::from_seconds(30);
        let skipped = faults.shown_wall(start) - Span::from_millis(5);
        assert_eq!(faults.true_wall(skipped), start);
    }

    #[test]
    fn text_names_all_faults() {
        let mut faults = ClockFaults {
            offset: Span::from_millis(-500),
            drift_ppm: 0.0,
            steps: Vec::new(),
            since: WallTime::from_unix_nanos(0),
        };
        assert_eq!(faults.to_string(), "offset -500 ms");
        faults.drift_ppm = 50.5;
        faults.steps.push(ClockFaultStep {
            at: Span::from_millis(1500),
            by: Span::from_seconds(3),
            clock: SteppedClock::Wall,
        });
        assert_eq!(faults.to_string(), "offset -500 ms, drift +50.5 ppm, step +3000 ms after 1.5 s");
    }

    #[test]
    fn text_has_configured_digits() {
        let step = |at, by| ClockFaultStep {
            at: Span::from_seconds(at),
            by: Span::from_micros(by),
            clock: SteppedClock::Wall,
        };
        let faults = ClockFaults {
            offset: Span::from_micros(-123_300),
            drift_ppm: 0.1,
            steps: (1..2000).map(|at| step(at, at * 100)).collect(),
            since: WallTime::from_unix_nanos(0),
        };
        let text = faults.to_string();
        // No configured number is longer than that of the last step. A rounding error would add digits.
        let longest = text.split([' ', ',']).map(str::len).max();
        assert!(longest.is_some_and(|longest| longest <= "+199.9".len()), "{text}");
        assert!(text.contains("step +6 ms after 60 s, step +6.1 ms after 61 s,"), "{text}");
    }
}
