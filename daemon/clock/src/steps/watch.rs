//! Detection of all disturbances of a host's clocks, from about ten readings of them per second.

use super::{LEAST_STEP, Readings, parts};
use crate::Span;

/// A disturbance between two readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disturbance {
    /// The wall clock was set forward (positive) or back.
    Step(Span),
    /// The wall clock runs faster (positive) or slower than before, against the free-running clock, by more than the
    /// limit; parts per million.
    Slew(f64),
    /// The machine slept for this long.
    Suspend(Span),
}

/// Comparison of all clocks of a host with each other.
///
/// A slew is a change of the wall clock's rate against `CLOCK_MONOTONIC_RAW`, not that rate itself: a machine whose
/// crystal is off by 60 ppm and whose time daemon compensates for it shows a constant 60 ppm and has an excellent wall
/// clock. A rate beyond that of any crystal (100 ppm) counts as a slew from the start; so does an injected drift that
/// exceeds it by more than the limit.
///
/// The limit is the one for a pair of hosts. Half of it may be due to the other host, but neither of them knows the
/// other's part; exchanges between the two detect what this check misses.
#[derive(Debug)]
pub struct ClockWatch {
    max_drift_ppm: f64,
    last: Option<Readings>,
    /// Reading from which the rate is measured.
    base: Option<Readings>,
    usual: Option<f64>,
    /// A rate other than the usual one, and its number of measurements in a row.
    other: (f64, u32),
}

impl ClockWatch {
    /// Injected drift up to which a clock is not considered stepped.
    const RATE_PPM: f64 = 500.0;
    /// Shortest sleep that is reported. Reading takes less time.
    const LEAST_SLEEP: Span = Span::from_millis(100);
    /// Shortest time over which a rate is measured. The time that reading takes is then below one part per million.
    const LEAST_TIME: Span = Span::from_seconds(5);
    const CRYSTAL_PPM: f64 = 100.0;
    /// Number of equal measurements after which a rate becomes the usual one.
    const SETTLED: u32 = 12;

    /// Creates a watch without readings; `max_drift_ppm` as in [`RelationSettings`](crate::RelationSettings).
    pub fn new(max_drift_ppm: f64) -> Self {
        Self { max_drift_ppm, last: None, base: None, usual: None, other: (0.0, 0) }
    }

    /// Compares a new reading with the last one. Returns the disturbances in between.
    pub fn compare(&mut self, now: Readings) -> Vec<Disturbance> {
        let mut odd = Vec::new();
        let Some(last) = self.last.replace(now) else {
            self.base = Some(now);
            return odd;
        };
        let passed = now.boot - last.boot;
        let slept = passed - (now.mono - last.mono);
        if slept > Self::LEAST_SLEEP {
            odd.push(Disturbance::Suspend(slept));
        }
        // The wall clock continues while the machine sleeps, and is set from a coarser clock when it wakes.
        let stepped = (now.wall - last.wall) - passed;
        if stepped.abs() > LEAST_STEP + parts(Self::RATE_PPM, passed) {
            odd.push(Disturbance::Step(stepped));
        }
        if odd.is_empty() {
            odd.extend(self.slewed(now).map(Disturbance::Slew));
        } else {
            self.base = Some(now);
        }
        odd
    }

    fn slewed(&mut self, now: Readings) -> Option<f64> {
        let base = *self.base.get_or_insert(now);
        let raw = now.raw - base.raw;
        if raw < Self::LEAST_TIME {
            return None;
        }
        self.base = Some(now);
        let rate = ((now.wall - base.wall) - raw).seconds() / raw.seconds() * 1e6;
        // Only a rate that a crystal can have may become the usual one.
        let crystal = rate.clamp(-Self::CRYSTAL_PPM, Self::CRYSTAL_PPM);
        let usual = self.usual.get_or_insert(crystal);
        if (rate - *usual).abs() <= self.max_drift_ppm {
            // Follows slow changes, as with temperature.
            *usual += (crystal - *usual) / 16.0;
            self.other.1 = 0;
            return None;
        }
        let slew = rate - *usual;
        let same = self.other.1 > 0 && (rate - self.other.0).abs() <= 1.0 + self.max_drift_ppm / 10.0;
        self.other = (rate, if same { self.other.1 + 1 } else { 1 });
        // A lasting rate is the clock's new normal state and is not reported for ever.
        if self.other.1 >= Self::SETTLED {
            self.usual = Some(crystal);
            self.other.1 = 0;
        }
        Some(slew)
    }
}
