//! The machine's clock, for the tests themselves.

use std::time::Duration;

use peernet_clock::{Clock, ClockIdentity, MonoTime, SystemClock, WallTime};

fn clock() -> SystemClock {
    SystemClock::new(ClockIdentity::new("tests", "system"))
}

/// Returns the time of the wall clock.
pub fn wall() -> WallTime {
    clock().wall()
}

/// Measures the time since its start.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch(MonoTime);

impl Stopwatch {
    /// Starts a stopwatch.
    pub fn start() -> Self {
        Self(clock().mono())
    }

    /// Returns the time since the start.
    pub fn elapsed(self) -> Duration {
        (clock().mono() - self.0).to_duration()
    }
}
