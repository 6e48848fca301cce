//! Detection of steps and slews of a wall clock, and of sleeps of the machine. No I/O: the input is the clocks'
//! readings.

mod step;
#[cfg(test)]
mod tests;
mod watch;

pub(crate) use step::{PairedReading, StepWatch};
pub use watch::{ClockWatch, Disturbance};

use crate::{MonoTime, RawTime, Span, WallTime};

/// All clocks of a host, read together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Readings {
    /// `CLOCK_REALTIME`, with injected faults if there are any.
    pub wall: WallTime,
    /// `CLOCK_MONOTONIC`: slewed like the wall clock, so that only steps change the difference between the two.
    pub mono: MonoTime,
    /// `CLOCK_MONOTONIC_RAW`: never slewed, so that a comparison with it shows the slews of the wall clock.
    pub raw: RawTime,
    /// `CLOCK_BOOTTIME`: continues while the machine sleeps.
    pub boot: MonoTime,
}

/// Largest change of the difference between two clocks that never counts as a step.
// Smaller changes may come from the time that reading takes.
const MIN_STEP: Span = Span::from_micros(20);
