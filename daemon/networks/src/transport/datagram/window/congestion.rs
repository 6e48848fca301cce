//! Congestion window: the number of bytes that may be in flight, derived from arrivals and losses.

use peernet_clock::MonoTime;

use super::PROGRESS_INTERVAL_BYTES;
use super::in_flight::FLIGHT_TIMEOUT;

/// Smallest size: more than arrives between two reports of progress. Bytes.
pub(super) const MIN_WINDOW: u32 = 4 * PROGRESS_INTERVAL_BYTES;

/// Initial size. Bytes.
pub(super) const INITIAL_WINDOW: u32 = 256 * 1024;

/// Relative growth per second after a loss: the size doubles in about three seconds.
const GROWTH_AFTER_LOSS: f64 = 0.25;

/// A size between [`MIN_WINDOW`] and the other end's limit. It grows with arrivals and is halved at losses.
#[derive(Debug)]
pub(super) struct CongestionWindow {
    max_window: u32,
    size: u32,
    /// As long as the window is smaller than this, it doubles with each round trip.
    threshold: u32,
    /// Time of the last arrival.
    progress_at: MonoTime,
    /// Number of bytes that had been sent at the last loss. Losses among these bytes do not shrink the window again.
    recovery_point: u64,
}

impl CongestionWindow {
    /// Creates a window. `max_window` is the other end's limit.
    pub(super) fn new(max_window: u32, now: MonoTime) -> Self {
        let max_window = max_window.max(MIN_WINDOW);
        Self {
            max_window,
            size: INITIAL_WINDOW.min(max_window),
            threshold: max_window,
            progress_at: now,
            recovery_point: 0,
        }
    }

    /// Returns the number of bytes that may be in flight.
    pub(super) const fn size(&self) -> u32 {
        self.size
    }

    /// Grows the window after a report of progress. `progress_bytes` is the number of bytes that have arrived or were
    /// lost since the last report; there must be at least one.
    pub(super) fn grow(&mut self, progress_bytes: u64, now: MonoTime) {
        // Growth by the number of reported bytes doubles the window with each round trip. Growth by time does not
        // depend on the round trip.
        let growth = if self.size < self.threshold {
            progress_bytes
        } else {
            // While the sender pauses, nothing shows that the path could carry more. A pause longer than
            // `FLIGHT_TIMEOUT` therefore counts as `FLIGHT_TIMEOUT`.
            let elapsed = (now - self.progress_at).min(FLIGHT_TIMEOUT).seconds();
            (f64::from(self.size) * GROWTH_AFTER_LOSS * elapsed).round() as u64
        };
        self.progress_at = now;
        self.size = u64::from(self.size).saturating_add(growth).min(u64::from(self.max_window)) as u32;
    }

    /// Shrinks the window after the loss of a message. `sent` is the number of bytes sent so far, `arrived_or_lost` the
    /// number of bytes that are no longer in flight.
    pub(super) fn shrink(&mut self, sent: u64, arrived_or_lost: u64) {
        // All losses among the bytes of one flight halve the window only once, as in TCP (RFC 6582).
        if arrived_or_lost < self.recovery_point {
            return;
        }
        self.recovery_point = sent;
        self.size = (self.size / 2).max(MIN_WINDOW);
        self.threshold = self.size;
    }
}
