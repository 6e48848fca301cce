//! Steps of one clock against another, found by whoever looks first.

use std::ops::Sub;

use super::{LEAST_STEP, parts};
use crate::{MonoTime, Span};

/// Something read between two looks at a clock: what another clock showed in nanoseconds, or several clocks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Paired<T = i64, C = MonoTime> {
    pub(crate) before: C,
    pub(crate) between: T,
    pub(crate) after: C,
}

/// So near together, two reads were not interrupted.
const NEAR: Span = Span::from_micros(3);
const TRIES: u32 = 8;

impl<T, C: Copy + Sub<Output = Span>> Paired<T, C> {
    /// Reads until nothing came in between; if something always does, the best of several.
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
    /// The other clock minus the monotonic one; off by half the gap at most.
    fn ahead(&self) -> Span {
        let mono = self.before.nanos() + self.gap().nanos() / 2;
        Span::from_nanos(self.between.saturating_sub(mono))
    }
}

/// Counts the steps of a clock against `CLOCK_MONOTONIC`, which is slewed together with the wall clock, so that the two move apart by
/// steps alone; `CLOCK_BOOTTIME` and it move apart by sleeps alone.
#[derive(Debug, Default)]
pub(crate) struct StepWatch {
    last: Option<Paired>,
    epoch: u32,
    last_step: Option<Span>,
}

impl StepWatch {
    /// Under libfaketime the wall clock may be given a rate of its own; that is no step.
    const RATE_PPM: f64 = 200.0;

    /// Looks, and says how often the clock was stepped so far.
    pub(crate) fn look(&mut self, now: Paired) -> u32 {
        let Some(last) = self.last.replace(now) else { return self.epoch };
        let moved = now.ahead() - last.ahead();
        let unsure = Span::from_nanos((now.gap() + last.gap()).nanos() / 2);
        if moved.abs() > LEAST_STEP + unsure + parts(Self::RATE_PPM, now.after - last.before) {
            self.epoch += 1;
            self.last_step = Some(moved);
        } else if now.gap() > NEAR && last.gap() < now.gap() {
            // An interrupted read could hide a step from all that follow.
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
