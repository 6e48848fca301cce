//! Everything that can go wrong with a host's clocks, from looking at all of them some ten times a second.

use super::{LEAST_STEP, Readings, parts};
use crate::Span;

/// What was odd since the last look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disturbance {
    /// The wall clock was set forward (positive) or back.
    Step(Span),
    /// It runs faster (positive) or slower than it used to, against the free-running clock, by more than the limit: parts per
    /// million.
    Slew(f64),
    /// The machine slept.
    Suspend(Span),
}

/// Compares all clocks of a host with each other.
///
/// A slew is a change of the wall clock's rate against `CLOCK_MONOTONIC_RAW`, not that rate itself: a machine whose
/// crystal is 60 ppm off and whose time daemon makes up for it shows 60 ppm for ever, and has an excellent wall clock.
/// What no crystal is off by (100 ppm) counts as a slew from the start; so does a rehearsed drift beyond that and the
/// limit. The limit is the one that concerns two hosts: half of it may be the other's, but neither knows, and the
/// exchanges between them find out what slips through.
#[derive(Debug)]
pub struct Watch {
    max_drift_ppm: f64,
    last: Option<Readings>,
    /// Where the measurement of the rate began.
    base: Option<Readings>,
    usual: Option<f64>,
    /// A rate other than the usual one, and how often in a row.
    other: (f64, u32),
}

impl Watch {
    /// What a rehearsed clock may drift without being taken for one that is stepped again and again.
    const RATE_PPM: f64 = 500.0;
    /// A sleep that was noticed: the two clocks are never further apart by reading them.
    const LEAST_SLEEP: Span = Span::from_millis(100);
    /// The shortest time that a rate is measured over: what reading costs is then below a part per million.
    const LEAST_TIME: Span = Span::from_seconds(5);
    const CRYSTAL_PPM: f64 = 100.0;
    /// A rate that stays for so many measurements is the usual one from then on.
    const SETTLED: u32 = 12;

    /// A watch that has seen nothing; `max_drift_ppm` as in [`RelationSettings`](crate::RelationSettings).
    pub fn new(max_drift_ppm: f64) -> Self {
        Self { max_drift_ppm, last: None, base: None, usual: None, other: (0.0, 0) }
    }

    /// What was odd since the last look; mostly nothing.
    pub fn look(&mut self, now: Readings) -> Vec<Disturbance> {
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
        // The wall clock goes on while the machine sleeps, and is set from a coarser clock when it wakes.
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
        let crystal = rate.clamp(-Self::CRYSTAL_PPM, Self::CRYSTAL_PPM);
        let usual = self.usual.get_or_insert(crystal);
        if (rate - *usual).abs() <= self.max_drift_ppm {
            *usual += (crystal - *usual) / 16.0;
            self.other.1 = 0;
            return None;
        }
        let slew = rate - *usual;
        let same = self.other.1 > 0 && (rate - self.other.0).abs() <= 1.0 + self.max_drift_ppm / 10.0;
        self.other = (rate, if same { self.other.1 + 1 } else { 1 });
        if self.other.1 >= Self::SETTLED {
            self.usual = Some(crystal);
            self.other.1 = 0;
        }
        Some(slew)
    }
}
