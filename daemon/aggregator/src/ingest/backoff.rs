//! Pauses between attempts to store after a failure.

use std::time::Duration;

/// The first pause after a failed attempt, and the longest one.
const FIRST_PAUSE: Duration = Duration::from_millis(200);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// Exponential backoff: each pause is twice as long as the previous one, up to `LONGEST_PAUSE`.
#[derive(Debug)]
pub(super) struct Backoff(Duration);

impl Backoff {
    /// Creates a backoff that begins with the shortest pause.
    pub(super) const fn new() -> Self {
        Self(FIRST_PAUSE)
    }

    /// Returns the next pause.
    pub(super) fn next(&mut self) -> Duration {
        let pause = self.0;
        self.0 = (pause * 2).min(LONGEST_PAUSE);
        pause
    }
}
