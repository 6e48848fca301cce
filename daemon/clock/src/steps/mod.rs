//! Noticing that a wall clock was stepped, runs off, or slept. No I/O: told what the clocks show, it says what is odd.

mod step;
#[cfg(test)]
mod tests;
mod watch;

pub(crate) use step::{Paired, StepWatch};
pub use watch::{Disturbance, Watch};

use crate::{MonoTime, RawTime, Span, WallTime};

/// All clocks of a host, read together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Readings {
    /// `CLOCK_REALTIME`, or what a rehearsal makes of it.
    pub wall: WallTime,
    /// `CLOCK_MONOTONIC`: slewed along with the wall clock, so that only steps show between the two.
    pub mono: MonoTime,
    /// `CLOCK_MONOTONIC_RAW`: never slewed, so that slews show against it.
    pub raw: RawTime,
    /// `CLOCK_BOOTTIME`: goes on while the machine sleeps.
    pub boot: MonoTime,
}

/// Below this a change between two clocks may be the reading of them.
const LEAST_STEP: Span = Span::from_micros(20);

/// `ppm` parts per million of a span.
fn parts(ppm: f64, of: Span) -> Span {
    Span::from_nanos((of.nanos() as f64 * ppm * 1e-6).round() as i64)
}
