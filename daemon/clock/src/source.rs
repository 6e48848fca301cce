//! Where time comes from: the `Clock` trait and the operating system's clock behind it.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use rustix::time::{ClockId, Timespec, clock_gettime};

use crate::steps::{Paired, StepWatch};
use crate::{ClockIdentity, MonoTime, Readings, RehearsalDescription, Span, WallTime};

/// Both clocks of a host, read together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// What the wall clock showed.
    pub wall: WallTime,
    /// What the monotonic clock showed.
    pub mono: MonoTime,
}

/// The only source of time in the workspace.
pub trait Clock: Send + Sync + fmt::Debug {
    /// Now on the wall clock.
    fn wall(&self) -> WallTime;

    /// Now on the monotonic clock.
    fn mono(&self) -> MonoTime;

    /// Which clock this is: two hosts with equal identities read the same clock.
    fn identity(&self) -> &ClockIdentity;

    /// Both clocks, read one right after the other: whoever is interrupted in between reads again, because that would
    /// look like a step.
    fn stamp(&self) -> Stamp {
        let read = || Paired { before: self.mono(), between: self.wall(), after: self.mono() };
        let Paired { before, between, .. } = Paired::read(read);
        Stamp { wall: between, mono: before }
    }

    /// All clocks of the host, for who watches over them.
    fn readings(&self) -> Readings {
        let Stamp { wall, mono } = self.stamp();
        Readings { wall, mono, raw: mono, boot: mono }
    }

    /// How often the wall clock was found to have been stepped. Looks: a step is noticed by the first call after
    /// it, so that stamps taken before a call belong to no later epoch than it returns.
    fn epoch(&self) -> u32 {
        0
    }

    /// The wall clock ran off in a way that only shows over time: from now on it counts as stepped.
    fn begin_epoch(&self) {}

    /// How far the wall clock was set by the last step that a call of [`epoch`](Self::epoch) noticed.
    fn last_step(&self) -> Option<Span> {
        None
    }

    /// What this clock would have shown when the system's wall clock showed `system`, a moment ago: a packet's
    /// stamp is made by the kernel, which knows nothing of a rehearsal.
    fn adopt(&self, system: WallTime) -> WallTime {
        system
    }

    /// How the clock is made wrong on purpose, if it is.
    fn rehearsal(&self) -> Option<&RehearsalDescription> {
        None
    }
}

/// A clock that is handed around.
pub type SharedClock = Arc<dyn Clock>;

/// The operating system's clocks. Clones notice steps together.
#[derive(Clone, Debug)]
pub struct SystemClock {
    identity: ClockIdentity,
    steps: Arc<Mutex<StepWatch>>,
}

impl SystemClock {
    /// The clocks of this machine under the given identity (see [`ClockIdentity::of_this_machine`]). Steps count from
    /// now on.
    pub fn new(identity: ClockIdentity) -> Self {
        let clock = Self { identity, steps: Arc::default() };
        clock.epoch();
        clock
    }

    fn steps(&self) -> MutexGuard<'_, StepWatch> {
        self.steps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn paired(&self) -> Paired {
        Paired { before: self.mono(), between: self.wall(), after: self.mono() }
    }
}

impl Clock for SystemClock {
    /// Through the C library, which `libfaketime` replaces; both ways end in the kernel's vDSO.
    #[inline]
    #[expect(clippy::disallowed_methods, reason = "this is where the injected clock gets its time")]
    fn wall(&self) -> WallTime {
        let nanos = match SystemTime::now().duration_since(UNIX_EPOCH) {
            Ok(since) => i64::try_from(since.as_nanos()).unwrap_or(i64::MAX),
            Err(before) => i64::try_from(before.duration().as_nanos()).map_or(i64::MIN, |nanos| -nanos),
        };
        WallTime::from_unix_nanos(nanos)
    }

    #[inline]
    fn mono(&self) -> MonoTime {
        mono(ClockId::Monotonic)
    }

    fn identity(&self) -> &ClockIdentity {
        &self.identity
    }

    fn readings(&self) -> Readings {
        let read = || {
            let before = self.mono();
            let between = (self.wall(), mono(ClockId::MonotonicRaw), mono(ClockId::Boottime));
            Paired { before, between, after: self.mono() }
        };
        let Paired { before, between: (wall, raw, boot), .. } = Paired::read(read);
        Readings { wall, mono: before, raw, boot }
    }

    fn epoch(&self) -> u32 {
        self.steps().look(Paired::read(|| self.paired()))
    }

    fn begin_epoch(&self) {
        self.steps().begin();
    }

    fn last_step(&self) -> Option<Span> {
        self.steps().last_step()
    }
}

fn mono(id: ClockId) -> MonoTime {
    MonoTime::from_nanos(nanos(clock_gettime(id)))
}

#[inline]
fn nanos(time: Timespec) -> i64 {
    time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)
}

#[cfg(test)]
mod tests {
    use super::*;

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
