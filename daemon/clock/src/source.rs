//! The `Clock` trait and the operating system's clock.

use std::fmt;
use std::ops::{Add, Sub};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::steps::{Paired, StepWatch};
use crate::system::{BOOT, MONO, RAW, WALL, is_kernels, read};
use crate::{ClockFaults, ClockIdentity, Interval, MonoTime, RawTime, Readings, Span, WallTime};

/// The clocks of a host, read together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// Time of the wall clock.
    pub wall: WallTime,
    /// Time of the monotonic clock.
    pub mono: MonoTime,
    /// Time of the free-running clock. It is read first, so that it is not later than the other two.
    pub raw: RawTime,
}

/// Returns the stamp a span later, if all clocks advance alike.
impl Add<Span> for Stamp {
    type Output = Self;
    fn add(self, span: Span) -> Self {
        Self { wall: self.wall + span, mono: self.mono + span, raw: self.raw + span }
    }
}

/// Returns the stamp a span earlier, if all clocks advanced alike.
impl Sub<Span> for Stamp {
    type Output = Self;
    fn sub(self, span: Span) -> Self {
        Self { wall: self.wall - span, mono: self.mono - span, raw: self.raw - span }
    }
}

/// The only source of time in the workspace.
pub trait Clock: Send + Sync + fmt::Debug {
    /// Returns the current time of the wall clock.
    fn wall(&self) -> WallTime;

    /// Returns the current time of the monotonic clock.
    fn mono(&self) -> MonoTime;

    /// Returns the current time of the free-running clock, by which the clocks of two hosts are related.
    fn raw(&self) -> RawTime;

    /// Returns the identity of the clock.
    fn identity(&self) -> &ClockIdentity;

    /// Reads the clocks one right after the other. An interrupted read is repeated, because it would look like a step.
    fn stamp(&self) -> Stamp {
        let read = || Paired { before: self.raw(), between: (self.wall(), self.mono()), after: self.raw() };
        let Paired { before, between: (wall, mono), .. } = Paired::read(read);
        Stamp { wall, mono, raw: before }
    }

    /// Returns the interval that contains the wall clock minus the free-running clock at this moment.
    fn wall_ahead(&self) -> Interval {
        let read = || Paired { before: self.raw(), between: self.wall(), after: self.raw() };
        let Paired { before, between, after } = Paired::read(read);
        let ahead = |raw: RawTime| Span::from_nanos(between.unix_nanos().saturating_sub(raw.nanos()));
        // A free-running clock with an injected step in between may go back.
        Interval::exactly(ahead(after)).hull(Interval::exactly(ahead(before)))
    }

    /// Reads all clocks of the host, for [`ClockWatch`](crate::ClockWatch).
    fn readings(&self) -> Readings {
        let Stamp { wall, mono, raw } = self.stamp();
        Readings { wall, mono, raw, boot: mono }
    }

    /// Returns the number of interruptions of the free-running clock: by sleeps of the machine and by calls of
    /// [`begin_epoch`](Self::begin_epoch).
    ///
    /// Each call checks for a sleep. A sleep is counted by the first call after it, so that stamps taken before a call
    /// belong to no later epoch than it returns. A stamp and a call next to it therefore reveal a sleep with the first
    /// message after it, before any periodic check does.
    fn epoch(&self) -> u32 {
        0
    }

    /// Begins an epoch after an interruption of the free-running clock that the clock itself cannot detect: stamps
    /// before and after it cannot be compared.
    fn begin_epoch(&self) {}

    /// Returns the number of detected steps of the wall clock. Each call checks for a step, as [`epoch`](Self::epoch)
    /// checks for a sleep.
    ///
    /// Steps matter to peers of session protocol 4 and to claims of time daemons, which concern wall clocks.
    fn wall_epoch(&self) -> u32 {
        0
    }

    /// Begins an epoch of the wall clock after a change of its rate, which only shows over time. It counts as a step.
    fn begin_wall_epoch(&self) {}

    /// Returns the size of the last step that a call of [`wall_epoch`](Self::wall_epoch) detected.
    fn last_step(&self) -> Option<Span> {
        None
    }

    /// Returns the time that this wall clock would have shown when the system's wall clock showed `system`, a moment
    /// ago. Packets are stamped by the kernel, which does not apply injected faults.
    fn adopt(&self, system: WallTime) -> WallTime {
        system
    }

    /// Returns whether the clocks currently show what the kernel shows by a direct system call. They do not if a
    /// preloaded library shows this process other times, or if faults are injected.
    fn shows_kernel_time(&self) -> bool {
        false
    }

    /// Returns the faults that are injected into the clock, if any.
    fn faults(&self) -> Option<&ClockFaults> {
        None
    }
}

/// A shared clock.
pub type SharedClock = Arc<dyn Clock>;

/// The operating system's clocks. Clones share the detection of steps and sleeps.
#[derive(Clone, Debug)]
pub struct SystemClock {
    identity: ClockIdentity,
    steps: Arc<Mutex<StepWatch>>,
    sleeps: Arc<Mutex<StepWatch>>,
}

impl SystemClock {
    /// Creates the clocks of this machine with an identity (see [`ClockIdentity::of_this_machine`]). Steps and sleeps
    /// count from now on.
    pub fn new(identity: ClockIdentity) -> Self {
        let clock = Self { identity, steps: Arc::default(), sleeps: Arc::default() };
        // The first reading is the reference of the detection.
        clock.epoch();
        clock.wall_epoch();
        clock
    }
}

/// Reads another clock between two reads of the monotonic clock.
fn beside_mono(other: impl Fn() -> i64) -> Paired {
    let mono = || MonoTime::from_nanos(read(MONO));
    Paired::read(|| Paired { before: mono(), between: other(), after: mono() })
}

fn lock(watch: &Mutex<StepWatch>) -> MutexGuard<'_, StepWatch> {
    // The state is valid after each assignment, so that a panic elsewhere does not invalidate it.
    watch.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Clock for SystemClock {
    #[inline]
    fn wall(&self) -> WallTime {
        WallTime::from_unix_nanos(read(WALL))
    }

    #[inline]
    fn mono(&self) -> MonoTime {
        MonoTime::from_nanos(read(MONO))
    }

    #[inline]
    fn raw(&self) -> RawTime {
        RawTime::from_nanos(read(RAW))
    }

    fn identity(&self) -> &ClockIdentity {
        &self.identity
    }

    fn readings(&self) -> Readings {
        let read = || {
            let before = self.mono();
            let between = (self.wall(), self.raw(), MonoTime::from_nanos(read(BOOT)));
            Paired { before, between, after: self.mono() }
        };
        let Paired { before, between: (wall, raw, boot), .. } = Paired::read(read);
        Readings { wall, mono: before, raw, boot }
    }

    fn epoch(&self) -> u32 {
        // Both clocks run at the same rate, so that any change between them is sleep.
        lock(&self.sleeps).compare(beside_mono(|| read(BOOT)))
    }

    fn begin_epoch(&self) {
        lock(&self.sleeps).begin();
    }

    fn wall_epoch(&self) -> u32 {
        lock(&self.steps).compare(beside_mono(|| read(WALL)))
    }

    fn begin_wall_epoch(&self) {
        lock(&self.steps).begin();
    }

    fn last_step(&self) -> Option<Span> {
        lock(&self.steps).last_step()
    }

    fn shows_kernel_time(&self) -> bool {
        use rustix::time::ClockId;
        let clocks = [(WALL, ClockId::Realtime), (MONO, ClockId::Monotonic), (RAW, ClockId::MonotonicRaw)];
        clocks.into_iter().all(|(clock, direct)| is_kernels(clock, direct))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FaultyClock;

    #[test]
    fn the_monotonic_clock_never_runs_backwards() {
        let clock = SystemClock::new(ClockIdentity::new("boot", "system"));
        let mut last = clock.mono();
        for _ in 0..10_000 {
            let now = clock.mono();
            assert!(now >= last);
            last = now;
        }
    }

    #[test]
    fn only_the_system_clock_shows_kernel_time() {
        let system = SystemClock::new(ClockIdentity::new("boot", "system"));
        assert!((0..10_000).all(|_| system.shows_kernel_time()));
        let wrong =
            ClockFaults { offset: Span::ZERO, drift_ppm: 0.0, steps: Vec::new(), since: system.wall() };
        let identity = system.identity().clone();
        let faulty = FaultyClock::new(Arc::new(system), identity, wrong);
        assert!(!faulty.shows_kernel_time());
    }

    #[test]
    fn the_wall_clock_is_the_systems() {
        let clock = SystemClock::new(ClockIdentity::new("boot", "system"));
        #[expect(clippy::disallowed_methods, reason = "the reference that the clock is compared with")]
        let reference = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .expect("the test machine's clock is after 1970");
        let difference = clock.wall() - WallTime::from_unix_nanos(reference.as_nanos() as i64);
        assert!(difference.abs() < Span::from_seconds(1), "{difference}");
    }
}
