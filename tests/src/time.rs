//! The machine's clock, for the tests themselves.

use std::time::Duration;

use peernet_clock::{Clock, ClockIdentity, MonoTime, SystemClock, WallTime};

fn clock() -> SystemClock {
    SystemClock::new(ClockIdentity::new("tests", "system"))
}

/// Now, on the wall.
pub fn wall() -> WallTime {
    clock().wall()
}

/// A moment that durations are counted from.
#[derive(Clone, Copy, Debug)]
pub struct Since(MonoTime);

impl Since {
    /// This one.
    pub fn now() -> Self {
        Self(clock().mono())
    }

    /// How long ago it was.
    pub fn elapsed(self) -> Duration {
        (clock().mono() - self.0).to_duration()
    }
}
