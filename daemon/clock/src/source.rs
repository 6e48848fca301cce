//! Where time comes from: the `Clock` trait and the operating system's clock behind it.

use std::fmt;
use std::ops::{Add, Sub};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::steps::{Paired, StepWatch};
use crate::system::{BOOT, MONO, RAW, WALL, is_kernels, read};
use crate::{ClockIdentity, Interval, MonoTime, RawTime, Readings, RehearsalDescription, Span, WallTime};

/// The clocks of a host, read together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// What the wall clock showed.
    pub wall: WallTime,
    /// What the monotonic clock showed.
    pub mono: MonoTime,
    /// What the free-running clock showed. It is read first, so that this is not later than the other two.
    pub raw: RawTime,
}

/// The clocks a span later, as far as they run alike meanwhile.
impl Add<Span> for Stamp {
    type Output = Self;
    fn add(self, span: Span) -> Self {
        Self { wall: self.wall + span, mono: self.mono + span, raw: self.raw + span }
    }
}

/// The clocks a span earlier, as far as they ran alike meanwhile.
impl Sub<Span> for Stamp {
    type Output = Self;
    fn sub(self, span: Span) -> Self {
        Self { wall: self.wall - span, mono: self.mono - span, raw: self.raw - span }
    }
}

/// The only source of time in the workspace.
pub trait Clock: Send + Sync + fmt::Debug {
    /// Now on the wall clock.
    fn wall(&self) -> WallTime;

    /// Now on the monotonic clock.
    fn mono(&self) -> MonoTime;

    /// Now on the free-running clock, by which clocks of two hosts are related.
    fn raw(&self) -> RawTime;

    /// Which clock this is.
    fn identity(&self) -> &ClockIdentity;

    /// The clocks, read one right after the other: whoever is interrupted in between reads again, because that would
    /// look like a step.
    fn stamp(&self) -> Stamp {
        let read = || Paired { before: self.raw(), between: (self.wall(), self.mono()), after: self.raw() };
        let Paired { before, between: (wall, mono), .. } = Paired::read(read);
        Stamp { wall, mono, raw: before }
    }

    /// How far the wall clock is ahead of the free-running one now; contains the truth.
    fn wall_ahead(&self) -> Interval {
        let read = || Paired { before: self.raw(), between: self.wall(), after: self.raw() };
        let Paired { before, between, after } = Paired::read(read);
        let ahead = |raw: RawTime| Span::from_nanos(between.unix_nanos().saturating_sub(raw.nanos()));
        // A free-running clock that was stepped on purpose in between may go back.
        Interval::exactly(ahead(after)).hull(Interval::exactly(ahead(before)))
    }

    /// All clocks of the host, for who watches over them.
    fn readings(&self) -> Readings {
        let Stamp { wall, mono, raw } = self.stamp();
        Readings { wall, mono, raw, boot: mono }
    }

    /// How often the free-running clock was interrupted: by a sleep of the machine, or by whatever
    /// [`begin_epoch`](Self::begin_epoch) was told of. Looks: a sleep is noticed by the first call after it, so that stamps taken
    /// before a call belong to no later epoch than it returns.
    fn epoch(&self) -> u32 {
        0
    }

    /// The free-running clock was interrupted in a way that it cannot notice itself: stamps before and after say nothing about
    /// each other.
    fn begin_epoch(&self) {}

    /// How often the wall clock was found to have been stepped; looks like [`epoch`](Self::epoch).
    fn wall_epoch(&self) -> u32 {
        0
    }

    /// The wall clock ran off in a way that only shows over time: from now on it counts as stepped.
    fn begin_wall_epoch(&self) {}

    /// How far the wall clock was set by the last step that a call of [`wall_epoch`](Self::wall_epoch) noticed.
    fn last_step(&self) -> Option<Span> {
        None
    }

    /// What this wall clock would have shown when the system's wall clock showed `system`, a moment ago: a packet's
    /// stamp is made by the kernel, which knows nothing of a rehearsal.
    fn adopt(&self, system: WallTime) -> WallTime {
        system
    }

    /// Whether the clocks show at this moment what the kernel shows by a direct system call: not where a preloaded library shows this
    /// process other times, nor where they are wrong on purpose.
    fn shows_kernel_time(&self) -> bool {
        false
    }

    /// How the clock is made wrong on purpose, if it is.
    fn rehearsal(&self) -> Option<&RehearsalDescription> {
        None
    }
}

/// A clock that is handed around.
pub type SharedClock = Arc<dyn Clock>;

/// The operating system's clocks. Clones notice steps and sleeps together.
#[derive(Clone, Debug)]
pub struct SystemClock {
    identity: ClockIdentity,
    steps: Arc<Mutex<StepWatch>>,
    sleeps: Arc<Mutex<StepWatch>>,
}

impl SystemClock {
    /// The clocks of this machine under the given identity (see [`ClockIdentity::of_this_machine`]). Steps and sleeps count from
    /// now on.
    pub fn new(identity: ClockIdentity) -> Self {
        let clock = Self { identity, steps: Arc::default(), sleeps: Arc::default() };
        clock.epoch();
        clock.wall_epoch();
        clock
    }
}

/// Reads another clock between two looks at the monotonic one.
fn beside_mono(other: impl Fn() -> i64) -> Paired {
    let mono = || MonoTime::from_nanos(read(MONO));
    Paired::read(|| Paired { before: mono(), between: other(), after: mono() })
}

fn lock(watch: &Mutex<StepWatch>) -> MutexGuard<'_, StepWatch> {
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
        // Both run at one rate: what comes between them is sleep.
        lock(&self.sleeps).look(beside_mono(|| read(BOOT)))
    }

    fn begin_epoch(&self) {
        lock(&self.sleeps).begin();
    }

    fn wall_epoch(&self) -> u32 {
        lock(&self.steps).look(beside_mono(|| read(WALL)))
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
    use crate::RehearsedClock;

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
        let wrong = RehearsalDescription {
            offset: Span::ZERO,
            drift_ppm: 0.0,
            steps: Vec::new(),
            since: system.wall(),
        };
        let identity = system.identity().clone();
        let rehearsed = RehearsedClock::new(Arc::new(system), identity, wrong);
        assert!(!rehearsed.shows_kernel_time());
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
