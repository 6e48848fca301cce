//! Pacing of datagrams to a configured rate.

use peernet_clock::{MonoTime, Span};

/// Longest time by which sending may be ahead of the configured rate.
const BURST: Span = Span::from_millis(2);

/// Spaces datagrams so that they are sent at the configured rate on average.
#[derive(Debug)]
pub(super) struct Pacer {
    /// Configured rate; `None` does not space datagrams.
    bytes_per_second: Option<u64>,
    /// Time at which the rate allows the next datagram.
    next_at: MonoTime,
}

impl Pacer {
    pub(super) fn new(bits_per_second: Option<u64>, now: MonoTime) -> Self {
        Self { bytes_per_second: bits_per_second.map(|bits| (bits / 8).max(1)), next_at: now }
    }

    /// Returns the time at which another datagram may be sent.
    pub(super) fn opens_at(&self) -> MonoTime {
        self.next_at - BURST
    }

    /// Notes that a datagram of `bytes` bytes was sent.
    pub(super) fn record_sent(&mut self, bytes: u32, now: MonoTime) {
        if let Some(rate) = self.bytes_per_second {
            let nanos = u64::from(bytes).saturating_mul(1_000_000_000) / rate;
            // A pause gives no credit; otherwise a long burst would follow the pause.
            self.next_at = self.next_at.max(now) + Span::from_nanos(i64::try_from(nanos).unwrap_or(i64::MAX));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pause_allows_at_most_one_burst() {
        let time_at = |millis| MonoTime::default() + Span::from_millis(millis);
        let mut pacer = Pacer::new(Some(8_000_000), time_at(0));
        pacer.record_sent(1_000, time_at(5_000));
        assert_eq!(pacer.opens_at(), time_at(4_999));
        pacer.record_sent(1_000, time_at(5_000));
        pacer.record_sent(1_000, time_at(5_000));
        assert_eq!(pacer.opens_at(), time_at(5_001));
        let mut unpaced = Pacer::new(None, time_at(0));
        unpaced.record_sent(u32::MAX, time_at(0));
        assert_eq!(unpaced.opens_at(), time_at(-2));
    }
}
