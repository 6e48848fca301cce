//! The `Clock` trait and the operating system's clock.

use std::fmt;
use std::ops::{Add, Sub};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::steps::{PairedReading, StepWatch};
use crate::system::{BOOT, MONO, RAW, WALL, matches_kernel, read};
use crate::{ClockFaults, ClockIdentity, Interval, MonoTime, RawTime, Readings, Span, WallTime};

/// Times of the wall clock, the monotonic clock and the free-running clock of a host, read together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// Time of the wall clock.
    pub wall: WallTime,
    /// Time of the monotonic clock.
    pub mono: MonoTime,
    /// Time of the free-running clock. This clock is read first, so that its time is not later than the other two
    /// times.
    pub raw: RawTime,
}

/// Adds a span to all three times.
impl Add<Span> for Stamp {
    type Output = Self;
    fn add(self, span: Span) -> Self {
        Self { wall: self.wall + span, mono: self.mono + span, raw: self.raw + span }
    }
}

/// Subtracts a span from all three times.
impl Sub<Span> for Stamp {
    type Output = Self;
    fn sub(self, span: Span) -> Self {
        Self { wall: self.wall - span, mono: self.mono - span, raw: self.raw - span }
    }
}

/// Clocks of a host, injected wherever the workspace needs the time.
pub trait Clock: Send + Sync + fmt::Debug {
    /// Returns the current time of the wall clock.
    fn wall(&self) -> WallTime;

    /// Returns the current time of the monotonic clock.
    fn mono(&self) -> MonoTime;

    /// Returns the current time of the free-running clock, by which the clocks of two hosts are related.
    fn raw(&self) -> RawTime;

    /// Returns the identity of the clock.
    fn identity(&self) -> &ClockIdentity;

    /// Reads the clocks in immediate succession. An interrupted reading is repeated.
    // A delay between the reads would look like a step.
    fn stamp(&self) -> Stamp {
        let read_clocks =
            || PairedReading { before: self.raw(), between: (self.wall(), self.mono()), after: self.raw() };
        let PairedReading { before, between: (wall, mono), .. } =
            PairedReading::read_uninterrupted(read_clocks);
        Stamp { wall, mono, raw: before }
    }

    /// Returns the interval that contains the wall clock minus the free-running clock at this moment.
    fn wall_ahead(&self) -> Interval {
        let read_clocks = || PairedReading { before: self.raw(), between: self.wall(), after: self.raw() };
        let PairedReading { before, between, after } = PairedReading::read_uninterrupted(read_clocks);
        let ahead = |raw: RawTime| Span::from_nanos(between.unix_nanos().saturating_sub(raw.nanos()));
        // The hull of the readings is used, because a free-running clock with an injected step may go back between the
        // two reads.
        Interval::exactly(ahead(after)).hull(Interval::exactly(ahead(before)))
    }

    /// Reads all clocks of the host, including the boot clock, for [`ClockWatch`](crate::ClockWatch).
    fn readings(&self) -> Readings {
        let Stamp { wall, mono, raw } = self.stamp();
        // Without a boot clock, the machine seems never to sleep.
        Readings { wall, mono, raw, boot: mono }
    }

    /// Returns the number of the current epoch: the number of interruptions of the free-running clock. Sleeps of the
    /// machine and calls of [`begin_epoch`](Self::begin_epoch) interrupt this clock.
    ///
    /// Each call checks for a sleep, and the first call after a sleep counts the sleep. Stamps that were taken before a
    /// call belong to the returned epoch or to an earlier epoch.
    // Code that stamps a message also calls this method, so that the first message after a sleep reveals the sleep,
    // before a periodic check does.
    fn epoch(&self) -> u32 {
        0
    }

    /// Starts a new epoch after an interruption of the free-running clock that the clock itself cannot detect. Stamps
    /// of different epochs cannot be compared.
    fn begin_epoch(&self) {}

    /// Returns the number of the current epoch of the wall clock: the number of detected steps of the wall clock. Each
    /// call checks for a step, as [`epoch`](Self::epoch) checks for a sleep.
    ///
    /// Steps of wall clocks matter only where wall clocks are used: by peers of session protocol 4 and in the claims of
    /// time daemons.
    fn wall_epoch(&self) -> u32 {
        0
    }

    /// Starts a new epoch of the wall clock after a change of its rate, which counts as a step.
    fn begin_wall_epoch(&self) {}

    /// Returns the size of the last step that a call of [`wall_epoch`](Self::wall_epoch) detected; `None` if there was
    /// none.
    fn last_step(&self) -> Option<Span> {
        None
    }

    /// Returns the time that this wall clock showed when the system's wall clock showed `system`.
    // The kernel stamps packets with the system's clock. Injected faults must be applied to these stamps afterwards.
    fn apply_faults(&self, system: WallTime) -> WallTime {
        system
    }

    /// Returns whether the clocks currently show the time of the kernel. They show another time if a preloaded library
    /// changes the times that this process reads, or if faults are injected.
    fn shows_kernel_time(&self) -> bool {
        false
    }

    /// Returns the faults that are injected into the clock, if any.
    fn injected_faults(&self) -> Option<&ClockFaults> {
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
    /// Creates the clocks of this machine with an identity (see [`ClockIdentity::from_system`]). Steps and sleeps
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
fn read_with_mono(other: impl Fn() -> i64) -> PairedReading {
    let mono = || MonoTime::from_nanos(read(MONO));
    PairedReading::read_uninterrupted(|| PairedReading { before: mono(), between: other(), after: mono() })
}

fn lock(watch: &Mutex<StepWatch>) -> MutexGuard<'_, StepWatch> {
    // The state is valid after each assignment, so a poisoned lock does no harm.
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
        let read_clocks = || {
            let before = self.mono();
            let between = (self.wall(), self.raw(), MonoTime::from_nanos(read(BOOT)));
            PairedReading { before, between, after: self.mono() }
        };
        let PairedReading { before, between: (wall, raw, boot), .. } =
            PairedReading::read_uninterrupted(read_clocks);
        Readings { wall, mono: before, raw, boot }
    }

    fn epoch(&self) -> u32 {
        // The boot clock and the monotonic clock run at the same rate. Their difference changes only while the machine
        // sleeps.
        lock(&self.sleeps).compare(read_with_mono(|| read(BOOT)))
    }

    fn begin_epoch(&self) {
        lock(&self.sleeps).begin_epoch();
    }

    fn wall_epoch(&self) -> u32 {
        lock(&self.steps).compare(read_with_mono(|| read(WALL)))
    }

    fn begin_wall_epoch(&self) {
        lock(&self.steps).begin_epoch();
    }

    fn last_step(&self) -> Option<Span> {
        lock(&self.steps).last_step()
    }

    fn shows_kernel_time(&self) -> bool {
        use rustix::time::ClockId;
        let clocks = [(WALL, ClockId::Realtime), (MONO, ClockId::Monotonic), (RAW, ClockId::MonotonicRaw)];
        clocks.into_iter().all(|(clock, rustix_clock)| matches_kernel(clock, rustix_clock))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FaultyClock;

    #[test]
    fn monotonic_clock_never_runs_backwards() {
        let clock = SystemClock::new(ClockIdentity::new("boot", "system"));
        let mut previous = clock.mono();
        for _ in 0..10_000 {
            let now = clock.mono();
            assert!(now >= previous);
            previous = now;
        }
    }

    #[test]
    fn only_the_system_clock_shows_kernel_time() {
        let system = SystemClock::new(ClockIdentity::new("boot", "system"));
        assert!((0..10_000).all(|_| system.shows_kernel_time()));
        let faults =
            ClockFaults { offset: Span::ZERO, drift_ppm: 0.0, steps: Vec::new(), since: system.wall() };
        let identity = system.identity().clone();
        let faulty = FaultyClock::new(Arc::new(system), identity, faults);
        assert!(!faulty.shows_kernel_time());
    }

    #[test]
    fn wall_clock_equals_system_time() {
        let clock = SystemClock::new(ClockIdentity::new("boot", "system"));
        #[expect(clippy::disallowed_methods, reason = "the reference that the clock is compared with")]
        let reference = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .expect("the test machine's clock is after 1970");
        let difference = clock.wall() - WallTime::from_unix_nanos(reference.as_nanos() as i64);
        assert!(difference.abs() < Span::from_seconds(1), "{difference}");
    }
}
