//! The only module that reads the operating system's clocks.

use nix::time::{ClockId, clock_gettime};

/// Wall-clock time, which time daemons step and slew.
pub(crate) const WALL: ClockId = ClockId::CLOCK_REALTIME;
/// Monotonic time: slewed like the wall clock, never stepped.
pub(crate) const MONO: ClockId = ClockId::CLOCK_MONOTONIC;
/// Free-running time: neither stepped nor slewed.
pub(crate) const RAW: ClockId = ClockId::CLOCK_MONOTONIC_RAW;
/// Monotonic time plus the time that the machine slept.
pub(crate) const BOOT: ClockId = ClockId::CLOCK_BOOTTIME;

/// Returns the time of a clock in nanoseconds since its own origin.
// The call goes through the C library, so that a preloaded library such as libfaketime changes all clocks alike. The C
// library uses the kernel's vDSO, so the call is as fast as a direct one.
#[inline]
pub(crate) fn read(clock: ClockId) -> i64 {
    let time = clock_gettime(clock).expect("Linux has had these four clocks since version 2.6.39");
    time.tv_sec().saturating_mul(1_000_000_000).saturating_add(time.tv_nsec())
}

/// Returns whether the C library returns the same time as the kernel. `rustix_clock` is the same clock as `clock`.
pub(crate) fn matches_kernel(clock: ClockId, rustix_clock: rustix::time::ClockId) -> bool {
    // Several attempts are made, because the wall clock may be set between two reads.
    (0..4).any(|_| {
        let before = read_from_kernel(rustix_clock);
        let shown = read(clock);
        before <= shown && shown <= read_from_kernel(rustix_clock)
    })
}

/// Returns the time of a clock, as [`read`] does.
// rustix does not call the C library, so that no preloaded library can change the time.
fn read_from_kernel(clock: rustix::time::ClockId) -> i64 {
    let time = rustix::time::clock_gettime(clock);
    time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)
}
