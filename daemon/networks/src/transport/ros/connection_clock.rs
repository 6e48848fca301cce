//! The clock of a connection.

use peernet_clock::{MonoTime, SharedClock, Span};
use tokio::time::Instant;

/// Clock of one end of a connection. The state machine of the connection counts time from the start of the
/// connection.
#[derive(Debug)]
pub(super) struct ConnectionClock {
    clock: SharedClock,
    start: Instant,
}

impl ConnectionClock {
    pub(super) fn start(clock: SharedClock) -> Self {
        Self { clock, start: Instant::now() }
    }

    /// Returns the current time for the state machine.
    pub(super) fn now(&self) -> MonoTime {
        // The time is taken from tokio's clock, because tokio's timers run on this clock.
        MonoTime::default() + Span::from(self.start.elapsed())
    }

    /// Converts a time of the state machine to an instant for timers.
    pub(super) fn instant(&self, time: MonoTime) -> Instant {
        self.start + (time - MonoTime::default()).to_duration()
    }

    /// Returns the wall-clock time in nanoseconds since the Unix epoch.
    pub(super) fn wall(&self) -> i64 {
        self.clock.wall().unix_nanos()
    }
}
