//! Computes the pause before the next connection attempt. No I/O.

use std::time::Duration;

use peernet_logger::HostId;
use peernet_statistics::SplitMix64;

/// Growing pauses with jitter, so that many edges do not reconnect to a restarted cloud at the same moment.
#[derive(Debug)]
pub(crate) struct ReconnectBackoff {
    next: Duration,
    random: SplitMix64,
}

impl ReconnectBackoff {
    pub(crate) const SHORTEST: Duration = Duration::from_millis(250);
    pub(crate) const LONGEST: Duration = Duration::from_secs(5);
    /// Pause after a refusal, which rarely ends without a change of configuration.
    pub(crate) const REFUSED: Duration = Duration::from_secs(15);

    /// Creates the sequence of pauses. The seed of the jitter is the host id, so that hosts differ.
    pub(crate) fn new(host: HostId) -> Self {
        let [a, b, c, d, e, f, g, h, ..] = *host.as_bytes();
        let seed = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
        Self { next: Self::SHORTEST, random: SplitMix64::new(seed) }
    }

    /// Returns the pause before the next attempt. It doubles each time up to the longest, ± 20 %.
    pub(crate) fn grow(&mut self) -> Duration {
        let pause = self.next;
        self.next = (pause * 2).min(Self::LONGEST);
        self.jitter(pause)
    }

    /// Makes the next pause the shortest again, after an attempt that succeeded.
    pub(crate) const fn reset(&mut self) {
        self.next = Self::SHORTEST;
    }

    /// Returns the pause after a refusal, ± 20 %.
    pub(crate) fn refused(&mut self) -> Duration {
        self.jitter(Self::REFUSED)
    }

    fn jitter(&mut self, pause: Duration) -> Duration {
        pause.mul_f64(0.8 + 0.4 * self.random.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_and_reset_after_success() {
        let mut reconnect_backoff = ReconnectBackoff::new(HostId::from_bytes([7; 16]));
        let around = |pause: Duration, middle: f64| (pause.as_secs_f64() / middle - 1.0).abs() <= 0.2;
        for middle in [0.25, 0.5, 1.0, 2.0, 4.0, 5.0, 5.0] {
            let pause = reconnect_backoff.grow();
            assert!(around(pause, middle), "{pause:?} should be about {middle} s");
        }
        reconnect_backoff.reset();
        assert!(around(reconnect_backoff.grow(), 0.25));
    }
}
