//! Pauses while every iteration of a closed loop, or every preparation (a reset or an advance between iterations),
//! fails. No I/O.

use peernet_clock::{MonoTime, Span};
use peernet_stream::Outcome;

/// Pause after a failed iteration of a closed loop, or after a failed preparation. The first consecutive failures cause
/// no pause; then the pause grows with each further failure.
///
/// Without the pause the loop would repeat the failures as fast as it can, for example while a model's queue is full or
/// no image can be read.
#[derive(Debug, Default)]
pub(super) struct FailureBackoff {
    consecutive_failures: u32,
    paused_until: Option<MonoTime>,
}

impl FailureBackoff {
    /// Number of consecutive failures that cause no pause, because a data set may contain a few bad samples.
    const FAILURES_BEFORE_PAUSE: u32 = 3;
    const MAX_PAUSE: Span = Span::from_seconds(1);

    /// Records the outcome of an iteration or a preparation that ended at `now`.
    pub(super) fn record_outcome(&mut self, outcome: &Outcome, now: MonoTime) {
        if *outcome == Outcome::Ok {
            *self = Self::default();
            return;
        }
        self.consecutive_failures = self.consecutive_failures.saturating_add(1);
        let excess = self.consecutive_failures.saturating_sub(Self::FAILURES_BEFORE_PAUSE);
        // The pauses are 2 ms, 4 ms and so on. The limit of the exponent prevents an overflow.
        let pause = Span::from_millis(1 << excess.min(10)).min(Self::MAX_PAUSE);
        self.paused_until = (excess > 0).then(|| now + pause);
    }

    /// Returns the end of the pause; `None` if the loop does not pause.
    pub(super) fn paused_until(&self, now: MonoTime) -> Option<MonoTime> {
        self.paused_until.filter(|until| *until > now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_failures_pause_until_success() {
        let (mut backoff, now) = (FailureBackoff::default(), MonoTime::from_nanos(0));
        let failed = Outcome::Failed("broken".into());
        let pauses: Vec<i64> = (0..16)
            .map(|_| {
                backoff.record_outcome(&failed, now);
                backoff.paused_until(now).map_or(0, |until| (until - now).nanos() / 1_000_000)
            })
            .collect();
        assert_eq!(pauses, [0, 0, 0, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1000, 1000, 1000, 1000]);
        backoff.record_outcome(&Outcome::Ok, now);
        assert_eq!(backoff.paused_until(now), None);
    }
}
