//! Delays before restarts of a process that died. No I/O.

use std::fmt::Display;

use peernet_clock::{MonoTime, Span};

/// Exponential backoff for restarts. The first restart after a successful call has no delay, the second has a delay of
/// 100 ms. Each further failure before the next success doubles the delay, up to 10 s.
#[derive(Clone, Debug, Default)]
pub struct RestartBackoff {
    /// Number of failures since the last successful call.
    consecutive_failures: u32,
    /// Earliest time of the next start.
    not_before: Option<MonoTime>,
    /// Text of the last failure.
    last_failure: String,
}

impl RestartBackoff {
    // A process that dies at every start would otherwise be restarted without pause, and use up the processor.
    const FIRST_DELAY: Span = Span::from_millis(100);
    const MAX_DELAY: Span = Span::from_seconds(10);

    /// Resets the delay after a successful call.
    pub fn record_success(&mut self) {
        *self = Self::default();
    }

    /// Records that the process died or could not be started.
    pub fn record_failure(&mut self, now: MonoTime, failure: &dyn Display) {
        let delay = match self.consecutive_failures {
            0 => Span::ZERO,
            consecutive_failures => {
                // Ten doublings already exceed `MAX_DELAY`; more would overflow at some point.
                Span::from_nanos(Self::FIRST_DELAY.nanos() << consecutive_failures.saturating_sub(1).min(10))
                    .min(Self::MAX_DELAY)
            }
        };
        self.consecutive_failures = self.consecutive_failures.saturating_add(1);
        self.not_before = Some(now + delay);
        self.last_failure = failure.to_string();
    }

    /// Returns the remaining time before the next start, with the text of the last failure; `None` if the process may be
    /// started now.
    pub fn remaining_delay(&self, now: MonoTime) -> Option<(Span, &str)> {
        let remaining = self.not_before? - now;
        (remaining > Span::ZERO).then_some((remaining, self.last_failure.as_str()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_grow_after_failures_and_reset_after_success() {
        let (mut restart_backoff, mut now) = (RestartBackoff::default(), MonoTime::from_nanos(0));
        let mut delays = Vec::new();
        for _ in 0..10 {
            restart_backoff.record_failure(now, &"killed");
            let delay = restart_backoff.remaining_delay(now).map_or(Span::ZERO, |(delay, _)| delay);
            delays.push(delay.nanos() / 1_000_000);
            now = now + delay;
            assert_eq!(restart_backoff.remaining_delay(now), None);
        }
        assert_eq!(delays, [0, 100, 200, 400, 800, 1600, 3200, 6400, 10_000, 10_000]);
        restart_backoff.record_success();
        restart_backoff.record_failure(now, &"killed");
        assert_eq!(restart_backoff.remaining_delay(now), None);
    }
}
