//! Congestion window: the bytes that may be in flight, by arrivals and losses.

use peernet_clock::MonoTime;

use super::PROGRESS_BYTES;
use super::in_flight::SILENCE;

/// Smallest size: more than arrives between two reports of progress. Bytes.
pub(super) const MIN_WINDOW: u32 = 4 * PROGRESS_BYTES;

/// Initial size. Bytes.
pub(super) const FIRST_WINDOW: u32 = 256 * 1024;

/// Growth in a second after a loss, as a part of the size: it doubles in three seconds.
const GROWTH_AFTER_LOSS: f64 = 0.25;

/// A size between [`MIN_WINDOW`] and what the other end takes, that grows with what arrives and is halved at losses.
#[derive(Debug)]
pub(super) struct CongestionWindow {
    most: u32,
    size: u32,
    /// Below it the window doubles with each round trip.
    threshold: u32,
    /// When something last arrived.
    progressed: MonoTime,
    /// Bytes that had left at the last loss: what is lost of them counts once.
    recovery: u64,
}

impl CongestionWindow {
    /// `most` is what the other end takes.
    pub(super) fn new(most: u32, now: MonoTime) -> Self {
        let most = most.max(MIN_WINDOW);
        Self { most, size: FIRST_WINDOW.min(most), threshold: most, progressed: now, recovery: 0 }
    }

    /// Bytes that may be in flight.
    pub(super) const fn size(&self) -> u32 {
        self.size
    }

    /// Grows after `arrived` bytes arrived, at least one.
    pub(super) fn grow(&mut self, arrived: u64, now: MonoTime) {
        let growth = if self.size < self.threshold {
            arrived
        } else {
            let elapsed = (now - self.progressed).min(SILENCE).seconds();
            (f64::from(self.size) * GROWTH_AFTER_LOSS * elapsed).round() as u64
        };
        self.progressed = now;
        self.size = u64::from(self.size).saturating_add(growth).min(u64::from(self.most)) as u32;
    }

    /// Shrinks after the loss of a message; `sent` bytes had left in all, and `arrived` of them were not in flight any more.
    pub(super) fn shrink(&mut self, sent: u64, arrived: u64) {
        if arrived < self.recovery {
            return;
        }
        self.recovery = sent;
        self.size = (self.size / 2).max(MIN_WINDOW);
        self.threshold = self.size;
    }
}
