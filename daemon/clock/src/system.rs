//! The one place where the operating system's clocks are read.

use nix::time::{ClockId, clock_gettime};

/// Calendar time, stepped and slewed by time daemons.
pub(crate) const WALL: ClockId = ClockId::CLOCK_REALTIME;
/// Slewed along with the wall clock, never stepped.
pub(crate) const MONO: ClockId = ClockId::CLOCK_MONOTONIC;
/// Neither stepped nor slewed.
pub(crate) const RAW: ClockId = ClockId::CLOCK_MONOTONIC_RAW;
/// The monotonic clock and the time that the machine slept.
pub(crate) const BOOT: ClockId = ClockId::CLOCK_BOOTTIME;

/// Returns what a clock shows: nanoseconds since its own origin.
///
/// Through the C library, so that a preloaded library such as libfaketime reaches all clocks alike; it ends in the kernel's vDSO
/// as a direct call would.
#[inline]
pub(crate) fn read(clock: ClockId) -> i64 {
    let time = clock_gettime(clock).expect("Linux has had these four clocks since version 2.6.39");
    time.tv_sec().saturating_mul(1_000_000_000).saturating_add(time.tv_nsec())
}
