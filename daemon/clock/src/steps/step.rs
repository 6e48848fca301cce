//! Steps of the wall clock, found by whoever looks first.

use super::{LEAST_STEP, parts};
use crate::{MonoTime, Span, WallTime};

/// Something read between two reads of the monotonic clock: the wall clock, or several clocks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Paired<T = WallTime> {
    pub(crate) before: MonoTime,
    pub(crate) between: T,
    pub(crate) after: MonoTime,
}

/// So near together, two reads were not interrupted.
const NEAR: Span = Span::from_micros(3);
const TRIES: u32 = 8;

impl<T> Paired<T> {
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
    /// Wall minus monotonic; off by half the gap at most.
    fn ahead(&self) -> Span {
        let mono = self.before.nanos() + self.gap().nanos() / 2;
        Span::from_nanos(self.between.unix_nanos().saturating_sub(mono))
    }
}

/// Counts the steps of a wall clock. `CLOCK_MONOTONIC` is slewed together with it, so that the two move apart by steps
/// alone.
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
