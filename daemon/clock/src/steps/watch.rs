//! Detection of all disturbances of a host's clocks, from about ten readings of the clocks per second.

use super::{MIN_STEP, Readings};
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

/// Detector of disturbances, which compares all clocks of a host with each other.
///
/// A slew is a change of the wall clock's rate against `CLOCK_MONOTONIC_RAW`. A constant rate is not a slew: on a
/// machine whose crystal is off by 60 ppm and whose time daemon compensates for this, the rate is a constant 60 ppm and
/// the wall clock is excellent. There is one exception: if the rate exceeds the rate error of any crystal (100 ppm) by
/// more than the limit, it counts as a slew even if it never changed.
// The limit applies to the clocks of two hosts together. A host does not know how much of it the other host uses, so
// this check allows each host the whole limit. Exchanges between the two hosts detect the violations that this check
// misses.
#[derive(Debug)]
pub struct ClockWatch {
    max_drift_ppm: f64,
    last: Option<Readings>,
    /// Reading from which the rate is measured.
    base: Option<Readings>,
    /// Rate of the wall clock in its normal state, parts per million.
    usual_rate: Option<f64>,
    /// The last rate that was not the usual rate, and how many measurements in a row gave this rate.
    deviating_rate: (f64, u32),
}

impl ClockWatch {
    /// Largest difference in rate that does not count as a step, for clocks with injected drift; parts per million.
    const MAX_RATE_DIFFERENCE_PPM: f64 = 500.0;
    /// Shortest sleep that is reported.
    // The time between the reads of two clocks, which looks like a sleep, is shorter.
    const MIN_SLEEP: Span = Span::from_millis(100);
    /// Shortest time over which a rate is measured.
    // Over this time, the duration of a reading falsifies the rate by less than one part per million.
    const MIN_MEASUREMENT_TIME: Span = Span::from_seconds(5);
    /// Largest rate error of a crystal, parts per million.
    const MAX_CRYSTAL_PPM: f64 = 100.0;
    /// Number of equal measurements after which a rate becomes the usual rate.
    const MEASUREMENTS_TO_SETTLE: u32 = 12;

    /// Creates a watch without readings; `max_drift_ppm` as in [`RelationSettings`](crate::RelationSettings).
    pub fn new(max_drift_ppm: f64) -> Self {
        Self { max_drift_ppm, last: None, base: None, usual_rate: None, deviating_rate: (0.0, 0) }
    }

    /// Compares a new reading with the last one. Returns the disturbances between the two.
    pub fn compare(&mut self, now: Readings) -> Vec<Disturbance> {
        let mut disturbances = Vec::new();
        let Some(last) = self.last.replace(now) else {
            self.base = Some(now);
            return disturbances;
        };
        let elapsed = now.boot - last.boot;
        let sleep = elapsed - (now.mono - last.mono);
        if sleep > Self::MIN_SLEEP {
            disturbances.push(Disturbance::Suspend(sleep));
        }
        // The wall clock continues while the machine sleeps. It is set from a coarser clock when the machine wakes up,
        // so a sleep may come with a step.
        let step = (now.wall - last.wall) - elapsed;
        if step.abs() > MIN_STEP + elapsed.drift(Self::MAX_RATE_DIFFERENCE_PPM) {
            disturbances.push(Disturbance::Step(step));
        }
        if disturbances.is_empty() {
            disturbances.extend(self.slew_since_base(now).map(Disturbance::Slew));
        } else {
            self.base = Some(now);
        }
        disturbances
    }

    /// Returns the slew since the base reading, if enough time has passed for a measurement.
    fn slew_since_base(&mut self, now: Readings) -> Option<f64> {
        let base = *self.base.get_or_insert(now);
        let raw_elapsed = now.raw - base.raw;
        if raw_elapsed < Self::MIN_MEASUREMENT_TIME {
            return None;
        }
        self.base = Some(now);
        let rate = ((now.wall - base.wall) - raw_elapsed).seconds() / raw_elapsed.seconds() * 1e6;
        // Only a rate that a crystal can have may become the usual one.
        let crystal_rate = rate.clamp(-Self::MAX_CRYSTAL_PPM, Self::MAX_CRYSTAL_PPM);
        let usual_rate = self.usual_rate.get_or_insert(crystal_rate);
        if (rate - *usual_rate).abs() <= self.max_drift_ppm {
            // The usual rate follows slow changes, such as those caused by temperature.
            *usual_rate += (crystal_rate - *usual_rate) / 16.0;
            self.deviating_rate.1 = 0;
            return None;
        }
        let slew = rate - *usual_rate;
        // Two rates count as equal if they differ by at most the error of a measurement and a tenth of the limit.
        let is_same_rate = self.deviating_rate.1 > 0
            && (rate - self.deviating_rate.0).abs() <= 1.0 + self.max_drift_ppm / 10.0;
        self.deviating_rate = (rate, if is_same_rate { self.deviating_rate.1 + 1 } else { 1 });
        // A rate that lasts becomes the usual rate, so that the slew is not reported for ever.
        if self.deviating_rate.1 >= Self::MEASUREMENTS_TO_SETTLE {
            self.usual_rate = Some(crystal_rate);
            self.deviating_rate.1 = 0;
        }
        Some(slew)
    }
}
