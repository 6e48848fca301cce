//! The only module that reads the operating system's clocks.

use nix::time::{ClockId, clock_gettime};

/// Calendar time, stepped and slewed by time daemons.
pub(crate) const WALL: ClockId = ClockId::CLOCK_REALTIME;
/// Monotonic time: slewed like the wall clock, never stepped.
pub(crate) const MONO: ClockId = ClockId::CLOCK_MONOTONIC;
/// Free-running time: neither stepped nor slewed.
pub(crate) const RAW: ClockId = ClockId::CLOCK_MONOTONIC_RAW;
/// Monotonic time plus the time that the machine slept.
pub(crate) const BOOT: ClockId = ClockId::CLOCK_BOOTTIME;

/// Returns the time of a clock in nanoseconds since its own origin.
///
/// The call goes through the C library, so that a preloaded library such as libfaketime reaches all clocks alike. It
/// uses the kernel's vDSO as a direct call would.
#[inline]
pub(crate) fn read(clock: ClockId) -> i64 {
    let time = clock_gettime(clock).expect("Linux has had these four clocks since version 2.6.39");
    time.tv_sec().saturating_mul(1_000_000_000).saturating_add(time.tv_nsec())
}

/// Returns whether the C library shows the same time as a direct system call, which no preloaded library reaches.
pub(crate) fn is_kernels(clock: ClockId, direct: rustix::time::ClockId) -> bool {
    // Several attempts, because the wall clock may be set between two reads.
    (0..4).any(|_| {
        let before = read_directly(direct);
        let shown = read(clock);
        before <= shown && shown <= read_directly(direct)
    })
}

fn read_directly(clock: rustix::time::ClockId) -> i64 {
    let time = rustix::time::clock_gettime(clock);
    time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)
}
