//! Pauses between attempts to connect. No I/O.

use std::time::Duration;

use peernet_clock::Span;
use peernet_logger::HostId;
use peernet_statistics::SplitMix64;

/// Growing pauses with jitter. The jitter prevents many edges from reconnecting to a restarted cloud at the same
/// moment.
#[derive(Debug)]
pub(crate) struct ReconnectBackoff {
    pause: Duration,
    random: SplitMix64,
}

impl ReconnectBackoff {
    pub(crate) const MIN_PAUSE: Duration = Duration::from_millis(250);
    pub(crate) const MAX_PAUSE: Duration = Duration::from_secs(5);
    /// Pause after a refusal, which rarely ends without a change of configuration.
    pub(crate) const PAUSE_AFTER_REFUSAL: Duration = Duration::from_secs(15);

    /// Creates the sequence of pauses. The seed of the jitter is the host id, so that the pauses of hosts differ.
    pub(crate) fn new(host: HostId) -> Self {
        let [a, b, c, d, e, f, g, h, ..] = *host.as_bytes();
        let seed = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
        Self { pause: Self::MIN_PAUSE, random: SplitMix64::new(seed) }
    }

    /// Returns the pause before the next attempt. The pause doubles with each call, up to
    /// [`MAX_PAUSE`](Self::MAX_PAUSE); the jitter is ± 20 %.
    pub(crate) fn next_pause(&mut self) -> Duration {
        let pause = self.pause;
        self.pause = (pause * 2).min(Self::MAX_PAUSE);
        self.add_jitter(pause)
    }

    /// Returns the pause before the first attempt to reconnect, after a connection that was in use for `used_for`.
    ///
    /// There is no pause if the connection was in use for [`MAX_PAUSE`](Self::MAX_PAUSE) or longer; the next pause is
    /// then the shortest one. Otherwise the pauses grow: an edge must not reconnect as fast as it can to a peer that
    /// accepts each session and closes it at once.
    pub(crate) fn pause_after_connection(&mut self, used_for: Span) -> Duration {
        if used_for.to_duration() < Self::MAX_PAUSE {
            return self.next_pause();
        }
        self.reset();
        Duration::ZERO
    }

    /// Resets the next pause to the shortest one, after a successful attempt.
    pub(crate) const fn reset(&mut self) {
        self.pause = Self::MIN_PAUSE;
    }

    /// Returns the pause after a refusal, ± 20 %.
    pub(crate) fn refusal_pause(&mut self) -> Duration {
        self.add_jitter(Self::PAUSE_AFTER_REFUSAL)
    }

    fn add_jitter(&mut self, pause: Duration) -> Duration {
        pause.mul_f64(0.8 + 0.4 * self.random.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_and_reset_after_success() {
        let mut reconnect_backoff = ReconnectBackoff::new(HostId::from_bytes([7; 16]));
        let is_about = |pause: Duration, middle: f64| (pause.as_secs_f64() / middle - 1.0).abs() <= 0.2;
        for middle in [0.25, 0.5, 1.0, 2.0, 4.0, 5.0, 5.0] {
            let pause = reconnect_backoff.next_pause();
            assert!(is_about(pause, middle), "{pause:?} should be about {middle} s");
        }
        reconnect_backoff.reset();
        assert!(is_about(reconnect_backoff.next_pause(), 0.25));
        for middle in [0.5, 1.0] {
            let pause = reconnect_backoff.pause_after_connection(Span::from_millis(4_999));
            assert!(is_about(pause, middle), "{pause:?} should be about {middle} s after a short connection");
        }
        assert_eq!(reconnect_backoff.pause_after_connection(Span::from_seconds(5)), Duration::ZERO);
        assert!(is_about(reconnect_backoff.next_pause(), 0.25));
    }
}
