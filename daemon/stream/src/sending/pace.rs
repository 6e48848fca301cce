//! Decision whether batches are compressed, from the observed rate of the link.

use peernet_clock::{MonoTime, Span};

use super::Compression;

/// Rate in bytes per second below which a link is slow. An agent at full speed produces a few megabytes of events per
/// second, which is little for a cable and too much for a poor radio link. Above this rate, compression would use
/// processor time of a host that is being measured without a benefit.
const SLOW: f64 = (4 << 20) as f64;

/// Rate above which a link is no longer slow. It is well above `SLOW`, so that a link in between does not cause
/// repeated changes.
const FAST: f64 = 2.0 * SLOW;

/// Time of waiting for acknowledgements from which on the rate is meaningful.
const OBSERVED: Span = Span::from_seconds(1);

/// Time without waiting after which compression has no benefit.
const CALM: Span = Span::from_seconds(10);

/// Observer of the bytes that are acknowledged while the window is full. Only then does the path to the store limit the
/// rate, and not the events.
///
/// A slow store looks like a slow link here; compression for it costs some processor time and does no harm. A store
/// that stopped for a while, because its disk was full, must not count: the longest wait is therefore ignored. A slow
/// link causes many waits.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    compression: Compression,
    compress: bool,
    /// Start of the time in which the window has been full.
    full: Option<MonoTime>,
    /// Last time at which the window was full.
    last_full: MonoTime,
    /// Time and bytes of frames observed while the window was full.
    observed: Span,
    bytes: u64,
    /// Longest wait, and the bytes that were acknowledged after it.
    longest: (Span, u64),
}

impl Pace {
    pub(super) fn new(compression: Compression) -> Self {
        let compress = compression == Compression::Always;
        let (observed, last_full) = (Span::ZERO, MonoTime::default());
        Self { compression, compress, full: None, last_full, observed, bytes: 0, longest: (Span::ZERO, 0) }
    }

    pub(super) const fn compresses(&self) -> bool {
        self.compress
    }

    /// Records that a batch must wait for an acknowledgement.
    pub(super) fn is_full(&mut self, now: MonoTime) {
        self.full.get_or_insert(now);
    }

    /// Records that data took too long to arrive.
    pub(super) fn is_slow(&mut self) {
        self.compress |= self.compression == Compression::Auto;
    }

    /// Records that nothing is to be sent. On a slow link compression stays on, because without it batches would soon
    /// wait again.
    pub(super) fn is_idle(&mut self, slow: bool, now: MonoTime) {
        self.pause(now);
        if self.compression == Compression::Auto && self.compress && !slow && now - self.last_full >= CALM {
            self.compress = false;
        }
    }

    /// Records that the connection ended, so that the current wait is meaningless.
    pub(super) fn interrupted(&mut self) {
        self.full = None;
    }

    /// Records that frames were acknowledged.
    pub(super) fn acknowledged(&mut self, bytes: u64, now: MonoTime) {
        let Some(since) = self.full else { return };
        self.pause(now);
        self.bytes += bytes;
        if now - since > self.longest.0 {
            self.longest = (now - since, bytes);
        }
        // Without the longest wait, which may be a pause of the store.
        let (observed, bytes) = (self.observed - self.longest.0, self.bytes - self.longest.1);
        if observed < OBSERVED {
            return;
        }
        let rate = bytes as f64 / observed.seconds();
        if self.compression == Compression::Auto {
            self.compress = if self.compress { rate < FAST } else { rate < SLOW };
        }
        (self.observed, self.bytes, self.longest) = (Span::ZERO, 0, (Span::ZERO, 0));
    }

    /// Ends the current wait.
    fn pause(&mut self, now: MonoTime) {
        if let Some(since) = self.full.take() {
            self.observed += now - since;
            self.last_full = now;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    /// Simulates a number of seconds in which the window is always full and `rate` bytes per second are acknowledged.
    fn wait(pace: &mut Pace, from: i64, seconds: i64, rate: u64) -> i64 {
        for n in 0..10 * seconds {
            pace.is_full(at(from + 100 * n));
            pace.acknowledged(rate / 10, at(from + 100 * (n + 1)));
        }
        from + 1_000 * seconds
    }

    #[test]
    fn a_slow_link_is_spared_and_a_fast_one_is_not() {
        let mut pace = Pace::new(Compression::Auto);
        let now = wait(&mut pace, 0, 5, 100 << 20);
        assert!(!pace.compresses());
        let now = wait(&mut pace, now, 2, 1 << 20);
        assert!(pace.compresses());
        let now = wait(&mut pace, now, 5, 6 << 20);
        assert!(pace.compresses(), "between the two nothing changes");
        let now = wait(&mut pace, now, 2, 20 << 20);
        assert!(!pace.compresses());
        wait(&mut pace, now, 5, 6 << 20);
        assert!(!pace.compresses());
    }

    #[test]
    fn round_trips_count_only_while_link_is_limit() {
        let mut pace = Pace::new(Compression::Auto);
        // Few events are acknowledged at once.
        for n in 0..1_000 {
            pace.acknowledged(1_000, at(100 * n));
            pace.is_idle(false, at(100 * n));
        }
        assert!(!pace.compresses());
        let now = wait(&mut pace, 100_000, 2, 1 << 10);
        pace.is_idle(false, at(now + 9_000));
        assert!(pace.compresses());
        pace.is_idle(false, at(now + 10_001));
        assert!(!pace.compresses(), "the backlog is gone");
        // Without compression batches would soon wait again.
        pace.is_slow();
        pace.is_idle(true, at(now + 30_000));
        assert!(pace.compresses(), "the link is slow");
        pace.is_idle(false, at(now + 30_000));
        assert!(!pace.compresses());
        // An outage does not count as slow.
        pace.is_full(at(200_000));
        pace.interrupted();
        pace.acknowledged(10, at(300_000));
        assert!(!pace.compresses());
    }

    #[test]
    fn stalled_store_does_not_count_as_slow_link() {
        let mut pace = Pace::new(Compression::Auto);
        let now = wait(&mut pace, 0, 5, 100 << 20);
        // The store's disk is full for a minute, and then everything is acknowledged.
        pace.is_full(at(now));
        pace.acknowledged(1 << 20, at(now + 60_000));
        wait(&mut pace, now + 60_000, 5, 100 << 20);
        assert!(!pace.compresses());
        // Batches that take three seconds each do count.
        for n in 0..6 {
            pace.is_full(at(100_000 + 3_000 * n));
            pace.acknowledged(128 << 10, at(100_000 + 3_000 * (n + 1)));
        }
        assert!(pace.compresses());
    }

    #[test]
    fn what_is_configured_is_obeyed() {
        for (compression, compresses) in [(Compression::Always, true), (Compression::Never, false)] {
            let mut pace = Pace::new(compression);
            let now = wait(&mut pace, 0, 3, 1 << 10);
            let now = wait(&mut pace, now, 3, 1 << 30);
            pace.is_idle(false, at(now + 60_000));
            assert_eq!(pace.compresses(), compresses);
        }
    }
}
