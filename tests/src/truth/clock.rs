//! Inverse of faulty clocks: conversion of a shown time to the time of the kernel's clock.

use chrono::DateTime;
use peernet_clock::{ClockFaultStep, ClockFaults, RawTime, Span, SteppedClock, WallTime};
use serde_json::Value;

use crate::clock_shim::ClockErrors;

/// Relation between a host's clocks and the kernel's.
#[derive(Clone, Debug)]
pub struct HostClock {
    /// Possible errors of the wall clock. The clock has one of them at each time. If there is none, stamps of the wall
    /// clock cannot be converted.
    wall: Vec<ClockFaults>,
    raw: RawError,
}

/// Error of a host's free-running clock.
#[derive(Clone, Debug)]
enum RawError {
    /// No error: the kernel's clock.
    None,
    /// The described fault, and the time of the kernel's free-running clock when the fault began.
    Faulty(ClockFaults, RawTime),
    /// The error that the shim shows.
    Shown(ClockErrors),
}

impl HostClock {
    /// Creates clocks with the described fault; `raw_since` is the time of the kernel's free-running clock when the
    /// fault began.
    pub fn new(faults: ClockFaults, raw_since: RawTime) -> Self {
        Self { raw: RawError::Faulty(faults.clone(), raw_since), wall: vec![faults] }
    }

    /// Creates clocks with the errors that the shim shows. Stamps of the wall clock cannot be converted.
    pub fn with_shim_errors(errors: ClockErrors) -> Self {
        Self { wall: Vec::new(), raw: RawError::Shown(errors) }
    }

    /// Creates a wall clock that is ahead by one of several offsets, at unknown times. The free-running clock is the
    /// kernel's.
    pub fn ahead_by(offsets: &[Span]) -> Self {
        let ahead = |offset: &Span| ClockFaults {
            offset: *offset,
            drift_ppm: 0.0,
            steps: Vec::new(),
            since: WallTime::default(),
        };
        Self { wall: offsets.iter().map(ahead).collect(), raw: RawError::None }
    }

    /// Creates the clocks from the faults that a host reports, in the API's form; returns `None` for anything else.
    /// `raw_at` converts a time of the kernel's wall clock to its free-running clock.
    pub fn from_report(faults: &Value, raw_at: impl FnOnce(WallTime) -> RawTime) -> Option<Self> {
        let span = |value: &Value| value.as_f64().map(Span::from_seconds_f64);
        let since = DateTime::parse_from_rfc3339(faults["since"].as_str()?).ok()?;
        let since = WallTime::from_unix_nanos(since.timestamp_nanos_opt()?);
        let steps = faults["steps"].as_array()?.iter();
        let steps =
            steps.map(|step| Some(ClockFaultStep::wall_step(span(&step["at_s"])?, span(&step["by_s"])?)));
        let description = ClockFaults {
            offset: span(&faults["offset_s"])?,
            drift_ppm: faults["drift_ppm"].as_f64()?,
            steps: steps.collect::<Option<_>>()?,
            since,
        };
        Some(Self::new(description, raw_at(since)))
    }

    /// Creates the kernel's clocks.
    pub fn of_kernel() -> Self {
        Self::ahead_by(&[Span::ZERO])
    }

    /// Returns the beginning of the fault by the kernel's wall clock.
    pub fn since(&self) -> Option<WallTime> {
        self.wall.first().map(|faults| faults.since)
    }

    /// Returns the beginning of the fault by the kernel's free-running clock.
    pub const fn raw_since(&self) -> Option<RawTime> {
        match &self.raw {
            RawError::Faulty(_, since) => Some(*since),
            RawError::None | RawError::Shown(_) => None,
        }
    }

    /// Returns the error of this wall clock when the kernel's wall clock shows `truth`.
    ///
    /// # Panics
    /// If the clock has one of several errors.
    pub fn ahead(&self, truth: WallTime) -> Span {
        let [faults] = &self.wall[..] else { panic!("the error is one of several: {:?}", self.wall) };
        faults.wall_error_at(truth)
    }

    /// Returns the time of the kernel's wall clock when this wall clock showed `shown`.
    ///
    /// # Panics
    /// If this clock never showed that time, because a step skipped it, or showed it twice.
    pub fn truth(&self, shown: WallTime) -> WallTime {
        let truths = self.truths(shown);
        assert_eq!(truths.len(), 1, "{shown:?} was not shown exactly once by {:?}", self.wall);
        truths[0]
    }

    /// Returns all times of the kernel's wall clock at which this wall clock showed `shown`. A clock that was set back shows
    /// some times twice.
    pub fn truths(&self, shown: WallTime) -> Vec<WallTime> {
        self.wall.iter().flat_map(|faults| truths(faults, shown)).collect()
    }

    /// Returns all times of the kernel's free-running clock at which this host's free-running clock showed `shown`, to one or two
    /// nanoseconds.
    pub fn raw_truths(&self, shown: RawTime) -> Vec<RawTime> {
        match &self.raw {
            RawError::None => vec![shown],
            RawError::Shown(errors) => errors.truths(shown),
            RawError::Faulty(description, since) => {
                // The formula is that of the wall clock, so times of the free-running clock are
                // converted to times of the wall clock. Only steps of the free-running clock apply.
                let steps = description.steps.iter().filter(|step| step.clock == SteppedClock::Raw).copied();
                let free_running = ClockFaults { steps: steps.collect(), ..description.clone() };
                let wall_minus_raw = description.since - WallTime::from_unix_nanos(since.nanos());
                let shown = WallTime::from_unix_nanos(shown.nanos()) + wall_minus_raw;
                let raw = |truth: WallTime| RawTime::from_nanos((truth - wall_minus_raw).unix_nanos());
                truths(&free_running, shown).map(raw).collect()
            }
        }
    }
}

/// Returns all times at which the faulty wall clock showed `shown`: the inverse of `ClockFaults::shown_wall`.
fn truths(faults: &ClockFaults, shown: WallTime) -> impl Iterator<Item = WallTime> {
    let steps = &faults.steps;
    (0..=steps.len()).filter_map(move |passed_steps| {
        let stepped: Span = steps[..passed_steps].iter().map(|step| step.by).sum();
        let shown_with_drift_only = shown - faults.offset - stepped;
        let nanos = (shown_with_drift_only - faults.since).nanos() as f64;
        let drift = nanos - nanos / (1.0 + faults.drift_ppm * 1e-6);
        let truth = shown_with_drift_only - Span::from_nanos(drift.round() as i64);
        let elapsed = truth - faults.since;
        let is_after_last_step = passed_steps == 0 || steps[passed_steps - 1].at <= elapsed;
        let is_before_next_step = passed_steps == steps.len() || elapsed < steps[passed_steps].at;
        (is_after_last_step && is_before_next_step).then_some(truth)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beginning of the faults, by the kernel's wall clock.
    fn since() -> WallTime {
        WallTime::from_unix_nanos(1_700_000_000_000_000_000)
    }

    /// Beginning of the faults, by the kernel's free-running clock.
    fn raw_since() -> RawTime {
        RawTime::from_nanos(77_000_000_000)
    }

    /// Returns an offset of -1 s, a drift of 100 ppm, and a step of the wall clock after 20 s.
    fn faults(step: Span) -> ClockFaults {
        let steps = vec![ClockFaultStep::wall_step(Span::from_seconds(20), step)];
        ClockFaults { offset: Span::from_seconds(-1), drift_ppm: 100.0, steps, since: since() }
    }

    #[test]
    fn inverse_of_clock_fault_returns_true_time() {
        let faults = faults(Span::from_seconds(3));
        let clock = HostClock::new(faults.clone(), raw_since());
        for nanos in [0, 1, 19_999_999_999, 20_000_000_000, 20_000_000_001, 500_000_000_007] {
            let truth = since() + Span::from_nanos(nanos);
            let computed = clock.truth(faults.shown_wall(truth));
            assert!((computed - truth).abs() <= Span::from_nanos(1), "{computed:?} {truth:?}");
            assert_eq!(truth + clock.ahead(truth), faults.shown_wall(truth));
        }
        assert_eq!(HostClock::of_kernel().truth(since()), since());
    }

    #[test]
    fn clock_set_back_shows_some_times_twice() {
        let faults = faults(Span::from_seconds(-3));
        let clock = HostClock::new(faults.clone(), raw_since());
        let at = |seconds| since() + Span::from_seconds(seconds);
        assert_eq!(clock.truths(faults.shown_wall(at(21))).len(), 2);
        assert_eq!(clock.truths(faults.shown_wall(at(16))), [at(16)]);
    }

    #[test]
    fn reported_fault_gives_the_same_clock() {
        let faults = faults(Span::from_seconds(3));
        let report = serde_json::json!({
            "offset_s": -1.0, "drift_ppm": 100.0, "since": "2023-11-14T22:13:20.000000000Z",
            "steps": [{ "at_s": 20.0, "by_s": 3.0 }],
        });
        let reported_clock = HostClock::from_report(&report, |_| raw_since()).expect("the API's form");
        let shown = faults.shown_wall(since() + Span::from_seconds(30));
        assert_eq!(reported_clock.truth(shown), HostClock::new(faults, raw_since()).truth(shown));
    }

    #[test]
    fn only_raw_steps_change_free_running_clock() {
        let wall_step = faults(Span::from_seconds(3));
        let mut raw_step = wall_step.clone();
        raw_step.steps[0].clock = SteppedClock::Raw;
        let truth = raw_since() + Span::from_seconds(25);
        // Because of the offset, a step of this clock skips the times from 19 s to 22 s.
        let in_step = raw_since() + Span::from_seconds(20);
        for (faults, truths_in_step) in [(wall_step, 1), (raw_step, 0)] {
            let clock = HostClock::new(faults.clone(), raw_since());
            let truths = clock.raw_truths(faults.shown_raw(truth, raw_since()));
            assert_eq!(truths.len(), 1, "{truths:?}");
            assert!((truths[0] - truth).abs() <= Span::from_nanos(1), "{truths:?}");
            assert_eq!(clock.raw_truths(in_step).len(), truths_in_step);
        }
    }
}
