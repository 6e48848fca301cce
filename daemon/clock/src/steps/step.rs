//! Detection of steps of one clock against another at each query.

use std::ops::Sub;

use super::MIN_STEP;
use crate::{MonoTime, Span};

/// A value that was read between two reads of a clock. The value is another clock's time in nanoseconds, or the times
/// of several clocks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PairedReading<T = i64, C = MonoTime> {
    pub(crate) before: C,
    pub(crate) between: T,
    pub(crate) after: C,
}

/// If the time between the two reads is longer than this, the reading counts as interrupted.
const MAX_UNINTERRUPTED_GAP: Span = Span::from_micros(3);
/// Maximum number of attempts to get an uninterrupted reading.
const MAX_READS: u32 = 8;

impl<T, C: Copy + Sub<Output = Span>> PairedReading<T, C> {
    /// Reads until a reading is not interrupted. If all readings are interrupted, returns the reading with the shortest
    /// gap.
    pub(crate) fn read_uninterrupted(mut read: impl FnMut() -> Self) -> Self {
        let mut best = read();
        for _ in 1..MAX_READS {
            if best.gap() <= MAX_UNINTERRUPTED_GAP {
                break;
            }
            let next = read();
            if next.gap() < best.gap() {
                best = next;
            }
        }
        best
    }

    fn gap(&self) -> Span {
        self.after - self.before
    }
}

impl PairedReading {
    /// Returns the time of the other clock minus that of the monotonic clock. The error is at most half the gap.
    fn difference(&self) -> Span {
        let mono = self.before.nanos() + self.gap().nanos() / 2;
        Span::from_nanos(self.between.saturating_sub(mono))
    }
}

/// Counter of the steps of a clock against `CLOCK_MONOTONIC`.
// The monotonic clock is slewed together with the wall clock, so only a step changes the difference between these two
// clocks. Only a sleep changes the difference between the monotonic clock and `CLOCK_BOOTTIME`.
#[derive(Debug, Default)]
pub(crate) struct StepWatch {
    last: Option<PairedReading>,
    epoch: u32,
    last_step: Option<Span>,
}

impl StepWatch {
    /// Largest difference in rate that does not count as a step, parts per million.
    // libfaketime can give the wall clock another rate.
    const MAX_RATE_DIFFERENCE_PPM: f64 = 200.0;

    /// Compares a new reading with the last one. Returns the number of steps so far, including the
    /// steps that [`begin_epoch`](Self::begin_epoch) counted.
    pub(crate) fn compare(&mut self, now: PairedReading) -> u32 {
        let Some(last) = self.last.replace(now) else { return self.epoch };
        let change = now.difference() - last.difference();
        // Each reading is uncertain by half of its gap.
        let uncertainty = Span::from_nanos((now.gap() + last.gap()).nanos() / 2);
        let rate_error = (now.after - last.before).drift(Self::MAX_RATE_DIFFERENCE_PPM);
        if change.abs() > MIN_STEP + uncertainty + rate_error {
            self.epoch += 1;
            self.last_step = Some(change);
        } else if now.gap() > MAX_UNINTERRUPTED_GAP && last.gap() + rate_error + rate_error < now.gap() {
            // An interrupted reading is uncertain. As a reference it could hide a step from all later readings, so the
            // better one of the two readings is kept as the reference. The older reading becomes worse with time: with a
            // slow clocksource all readings seem interrupted, and one reading would otherwise stay the reference for
            // hours.
            self.last = Some(last);
        }
        self.epoch
    }

    /// Counts a step that no reading showed.
    pub(crate) fn begin_epoch(&mut self) {
        self.epoch += 1;
    }

    /// Returns the size of the last step that a reading showed.
    pub(crate) fn last_step(&self) -> Option<Span> {
        self.last_step
    }
}
