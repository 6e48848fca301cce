//! Where time comes from: the `Clock` trait and the operating system's clock behind it.

use std::fmt;
use std::sync::Arc;

use rustix::time::{ClockId, Timespec, clock_gettime};

use crate::{ClockIdentity, MonoTime, WallTime};

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

    /// Both clocks, read one right after the other.
    fn stamp(&self) -> Stamp {
        Stamp { wall: self.wall(), mono: self.mono() }
    }
}

/// A clock that is handed around.
pub type SharedClock = Arc<dyn Clock>;

/// The operating system's clocks.
#[derive(Clone, Debug)]
pub struct SystemClock {
    identity: ClockIdentity,
}

impl SystemClock {
    /// The clocks of this machine under the given identity (see [`ClockIdentity::of_this_machine`]).
    pub fn new(identity: ClockIdentity) -> Self {
        Self { identity }
    }
}

impl Clock for SystemClock {
    #[inline]
    fn wall(&self) -> WallTime {
        WallTime::from_unix_nanos(nanos(clock_gettime(ClockId::Realtime)))
    }

    #[inline]
    fn mono(&self) -> MonoTime {
        MonoTime::from_nanos(nanos(clock_gettime(ClockId::Monotonic)))
    }

    fn identity(&self) -> &ClockIdentity {
        &self.identity
    }
}

#[inline]
fn nanos(time: Timespec) -> i64 {
    time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Span;

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
