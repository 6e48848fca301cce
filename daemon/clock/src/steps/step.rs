//! Detection of steps of one clock against another, at each query.

use std::ops::Sub;

use super::{LEAST_STEP, parts};
use crate::{MonoTime, Span};

/// A value read between two reads of a clock: another clock's time in nanoseconds, or several clocks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Paired<T = i64, C = MonoTime> {
    pub(crate) before: C,
    pub(crate) between: T,
    pub(crate) after: C,
}

/// Longest gap between two reads that were not interrupted.
const NEAR: Span = Span::from_micros(3);
const TRIES: u32 = 8;

impl<T, C: Copy + Sub<Output = Span>> Paired<T, C> {
    /// Reads until a read is not interrupted. Returns the one with the shortest gap if all of them are.
    pub(crate) fn read(mut once: impl FnMut() -> Self) -> Self {
        let mut best = once();
        for _ in 1..TRIES {
            if best.gap() <= NEAR {
                break;
            }
            let next = once();
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

impl Paired {
    /// Returns the other clock minus the monotonic one; the error is at most half the gap.
    fn ahead(&self) -> Span {
        let mono = self.before.nanos() + self.gap().nanos() / 2;
        Span::from_nanos(self.between.saturating_sub(mono))
    }
}

/// Counter of the steps of a clock against `CLOCK_MONOTONIC`. That clock is slewed together with the wall clock, so
/// that the two move apart by steps only; `CLOCK_BOOTTIME` moves away from it by sleeps only.
#[derive(Debug, Default)]
pub(crate) struct StepWatch {
    last: Option<Paired>,
    epoch: u32,
    last_step: Option<Span>,
}

impl StepWatch {
    /// Largest difference in rate that is no step: libfaketime can give the wall clock another rate.
    const RATE_PPM: f64 = 200.0;

    /// Compares a new reading with the last one. Returns the number of steps so far.
    pub(crate) fn compare(&mut self, now: Paired) -> u32 {
        let Some(last) = self.last.replace(now) else { return self.epoch };
        let moved = now.ahead() - last.ahead();
        // Each reading is uncertain by half of its gap.
        let unsure = Span::from_nanos((now.gap() + last.gap()).nanos() / 2);
        if moved.abs() > LEAST_STEP + unsure + parts(Self::RATE_PPM, now.after - last.before) {
            self.epoch += 1;
            self.last_step = Some(moved);
        } else if now.gap() > NEAR && last.gap() < now.gap() {
            // An interrupted reading could hide a step from all readings that follow, so that the better one is kept.
            self.last = Some(last);
        }
        self.epoch
    }

    pub(crate) fn begin(&mut self) {
        self.epoch += 1;
    }

    pub(crate) fn last_step(&self) -> Option<Span> {
        self.last_step
    }
}
