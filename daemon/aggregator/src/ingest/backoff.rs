//! Pauses between attempts to store after a failure.

use std::time::Duration;

/// Pause after the first failed attempt.
const FIRST_PAUSE: Duration = Duration::from_millis(200);
/// Upper limit of all pauses.
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
