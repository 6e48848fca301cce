//! Decision whether batches are compressed, from the observed rate of the link.

use peernet_clock::{MonoTime, Span};

use super::Compression;

/// A link is slow if its rate in bytes per second is below this limit. An agent at full speed produces a few megabytes
/// of events per second, which is little for a cable and too much for a poor radio link. Above this rate, compression
/// would have no benefit and would use processor time of a host that is being measured.
const SLOW_BYTES_PER_S: f64 = (4 << 20) as f64;

/// A slow link stops being slow if its rate is above this limit. The limit is well above `SLOW_BYTES_PER_S`, so that a
/// link with a rate between the two limits does not switch compression repeatedly.
const FAST_BYTES_PER_S: f64 = 2.0 * SLOW_BYTES_PER_S;

/// Minimum time of waiting for acknowledgements over which a rate is computed.
const MIN_OBSERVATION: Span = Span::from_seconds(1);

/// Time without waiting for acknowledgements after which compression stops.
const IDLE_BEFORE_STOP: Span = Span::from_seconds(10);

/// Measures the rate of acknowledged bytes while the window of batches in flight is full, and switches compression. The
/// path to the store limits the rate only while the window is full; otherwise the number of events limits the rate.
///
/// A slow store looks like a slow link; compression then costs some processor time and does no harm. A pause of the
/// store, for example because its disk was full, must not count: the longest wait is therefore ignored. A slow link
/// causes many waits.
#[derive(Clone, Debug)]
pub(super) struct CompressionControl {
    compression: Compression,
    is_compressing: bool,
    /// Start of the current wait, in which the window has been full; `None` if the window is not full.
    full_since: Option<MonoTime>,
    /// Last time at which the window was full.
    last_full: MonoTime,
    /// Sum of the waits since the rate was last computed.
    full_time: Span,
    /// Bytes that were acknowledged in `full_time`.
    full_bytes: u64,
    /// Longest wait, and the bytes that were acknowledged after it.
    longest_wait: (Span, u64),
}

impl CompressionControl {
    pub(super) fn new(compression: Compression) -> Self {
        let is_compressing = compression == Compression::Always;
        let (full_time, last_full) = (Span::ZERO, MonoTime::default());
        Self {
            compression,
            is_compressing,
            full_since: None,
            last_full,
            full_time,
            full_bytes: 0,
            longest_wait: (Span::ZERO, 0),
        }
    }

    pub(super) const fn is_compressing(&self) -> bool {
        self.is_compressing
    }

    /// Records that a batch must wait for an acknowledgement. A wait for an echo counts like a full window.
    pub(super) fn record_full_window(&mut self, now: MonoTime) {
        self.full_since.get_or_insert(now);
    }

    /// Records that the flow control found the link slow: sent bytes took too long to reach the aggregator.
    pub(super) fn record_slow_link(&mut self) {
        self.is_compressing |= self.compression == Compression::Auto;
    }

    /// Records that nothing is to be sent. On a slow link, compression continues: without compression, batches would
    /// soon wait again.
    pub(super) fn record_idle(&mut self, is_slow: bool, now: MonoTime) {
        self.end_wait(now);
        if self.compression == Compression::Auto
            && self.is_compressing
            && !is_slow
            && now - self.last_full >= IDLE_BEFORE_STOP
        {
            self.is_compressing = false;
        }
    }

    /// Records that the connection ended, so the current wait is meaningless.
    pub(super) fn record_interruption(&mut self) {
        self.full_since = None;
    }

    /// Records that batches were acknowledged; `bytes` is the number of bytes of their frames.
    pub(super) fn record_ack(&mut self, bytes: u64, now: MonoTime) {
        let Some(full_since) = self.full_since else { return };
        self.end_wait(now);
        self.full_bytes += bytes;
        if now - full_since > self.longest_wait.0 {
            self.longest_wait = (now - full_since, bytes);
        }
        // The longest wait is subtracted, because it may be a pause of the store.
        let (observed, bytes) = (self.full_time - self.longest_wait.0, self.full_bytes - self.longest_wait.1);
        if observed < MIN_OBSERVATION {
            return;
        }
        let rate = bytes as f64 / observed.seconds();
        if self.compression == Compression::Auto {
            let threshold = if self.is_compressing { FAST_BYTES_PER_S } else { SLOW_BYTES_PER_S };
            self.is_compressing = rate < threshold;
        }
        (self.full_time, self.full_bytes, self.longest_wait) = (Span::ZERO, 0, (Span::ZERO, 0));
    }

    /// Ends the current wait.
    fn end_wait(&mut self, now: MonoTime) {
        if let Some(full_since) = self.full_since.take() {
            self.full_time += now - full_since;
            self.last_full = now;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLOW: bool = true;
    const NOT_SLOW: bool = false;

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    /// Simulates a number of seconds in which the window is always full and `rate` bytes per second are acknowledged.
    /// Returns the time at the end, in milliseconds.
    fn acknowledge_steadily(
        compression_control: &mut CompressionControl,
        from: i64,
        seconds: i64,
        rate: u64,
    ) -> i64 {
        for n in 0..10 * seconds {
            compression_control.record_full_window(at(from + 100 * n));
            compression_control.record_ack(rate / 10, at(from + 100 * (n + 1)));
        }
        from + 1_000 * seconds
    }

    #[test]
    fn only_slow_link_compresses_batches() {
        let mut compression_control = CompressionControl::new(Compression::Auto);
        let now = acknowledge_steadily(&mut compression_control, 0, 5, 100 << 20);
        assert!(!compression_control.is_compressing());
        let now = acknowledge_steadily(&mut compression_control, now, 2, 1 << 20);
        assert!(compression_control.is_compressing());
        let now = acknowledge_steadily(&mut compression_control, now, 5, 6 << 20);
        assert!(compression_control.is_compressing(), "nothing changes at a rate between the two limits");
        let now = acknowledge_steadily(&mut compression_control, now, 2, 20 << 20);
        assert!(!compression_control.is_compressing());
        acknowledge_steadily(&mut compression_control, now, 5, 6 << 20);
        assert!(!compression_control.is_compressing());
    }

    #[test]
    fn acknowledgements_count_only_while_window_is_full() {
        let mut compression_control = CompressionControl::new(Compression::Auto);
        // Each batch is small and is acknowledged immediately, so the window is never full.
        for n in 0..1_000 {
            compression_control.record_ack(1_000, at(100 * n));
            compression_control.record_idle(NOT_SLOW, at(100 * n));
        }
        assert!(!compression_control.is_compressing());
        let now = acknowledge_steadily(&mut compression_control, 100_000, 2, 1 << 10);
        compression_control.record_idle(NOT_SLOW, at(now + 9_000));
        assert!(compression_control.is_compressing());
        compression_control.record_idle(NOT_SLOW, at(now + 10_001));
        assert!(!compression_control.is_compressing(), "the backlog is gone");
        // On a slow link, compression continues although nothing waits.
        compression_control.record_slow_link();
        compression_control.record_idle(SLOW, at(now + 30_000));
        assert!(compression_control.is_compressing(), "the link is slow");
        compression_control.record_idle(NOT_SLOW, at(now + 30_000));
        assert!(!compression_control.is_compressing());
        // An interruption of the connection does not count as a slow link.
        compression_control.record_full_window(at(200_000));
        compression_control.record_interruption();
        compression_control.record_ack(10, at(300_000));
        assert!(!compression_control.is_compressing());
    }

    #[test]
    fn stalled_store_does_not_count_as_slow_link() {
        let mut compression_control = CompressionControl::new(Compression::Auto);
        let now = acknowledge_steadily(&mut compression_control, 0, 5, 100 << 20);
        // The store's disk is full for a minute, and then everything is acknowledged.
        compression_control.record_full_window(at(now));
        compression_control.record_ack(1 << 20, at(now + 60_000));
        acknowledge_steadily(&mut compression_control, now + 60_000, 5, 100 << 20);
        assert!(!compression_control.is_compressing());
        // Batches that take three seconds each do count.
        for n in 0..6 {
            compression_control.record_full_window(at(100_000 + 3_000 * n));
            compression_control.record_ack(128 << 10, at(100_000 + 3_000 * (n + 1)));
        }
        assert!(compression_control.is_compressing());
    }

    #[test]
    fn configured_compression_overrides_measurements() {
        for (compression, compresses) in [(Compression::Always, true), (Compression::Never, false)] {
            let mut compression_control = CompressionControl::new(compression);
            let now = acknowledge_steadily(&mut compression_control, 0, 3, 1 << 10);
            let now = acknowledge_steadily(&mut compression_control, now, 3, 1 << 30);
            compression_control.record_idle(NOT_SLOW, at(now + 60_000));
            assert_eq!(compression_control.is_compressing(), compresses);
        }
    }
}
