//! A clock for tests that moves only by method calls.

use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};

use crate::{Clock, ClockIdentity, MonoTime, RawTime, Readings, Span, Stamp, WallTime};

/// A clock for tests: each of its clocks moves only by the methods of this type.
#[derive(Debug)]
pub struct ManualClock {
    wall: AtomicI64,
    mono: AtomicI64,
    /// Sum of all simulated sleeps, nanoseconds.
    total_sleep: AtomicI64,
    epoch: AtomicU32,
    wall_epoch: AtomicU32,
    last_step: AtomicI64,
    identity: ClockIdentity,
}

impl ManualClock {
    /// Time that the free-running clock shows at first. It is not zero, so that a test notices if stamps of the
    /// free-running and the monotonic clock are confused.
    pub const FIRST_RAW: RawTime = RawTime::from_nanos(5_000_000_000_000);

    /// Creates a clock whose wall clock shows `wall`, whose monotonic clock shows zero and whose free-running clock
    /// shows [`FIRST_RAW`](Self::FIRST_RAW).
    pub fn new(wall: WallTime, identity: ClockIdentity) -> Self {
        Self {
            wall: AtomicI64::new(wall.unix_nanos()),
            mono: AtomicI64::new(0),
            total_sleep: AtomicI64::new(0),
            epoch: AtomicU32::new(0),
            wall_epoch: AtomicU32::new(0),
            last_step: AtomicI64::new(0),
            identity,
        }
    }

    /// Advances all clocks by `span`.
    pub fn advance(&self, span: Span) {
        self.wall.fetch_add(span.nanos(), Ordering::SeqCst);
        self.mono.fetch_add(span.nanos(), Ordering::SeqCst);
    }

    /// Simulates a sleep of the machine: advances the wall clock and the boot clock, and counts an
    /// interruption of the free-running clock ([`Clock::epoch`]).
    pub fn sleep(&self, span: Span) {
        self.wall.fetch_add(span.nanos(), Ordering::SeqCst);
        self.total_sleep.fetch_add(span.nanos(), Ordering::SeqCst);
        self.epoch.fetch_add(1, Ordering::SeqCst);
    }

    /// Moves the wall clock without a new epoch, like a time daemon that slews it.
    pub fn slew_wall(&self, by: Span) {
        self.wall.fetch_add(by.nanos(), Ordering::SeqCst);
    }

    /// Steps the wall clock forward or back, like an administrator. A step of any size starts a new epoch of the wall
    /// clock ([`Clock::wall_epoch`]).
    pub fn step_wall(&self, by: Span) {
        self.wall.fetch_add(by.nanos(), Ordering::SeqCst);
        self.last_step.store(by.nanos(), Ordering::SeqCst);
        self.wall_epoch.fetch_add(1, Ordering::SeqCst);
    }
}

impl Clock for ManualClock {
    fn wall(&self) -> WallTime {
        WallTime::from_unix_nanos(self.wall.load(Ordering::SeqCst))
    }

    fn mono(&self) -> MonoTime {
        MonoTime::from_nanos(self.mono.load(Ordering::SeqCst))
    }

    fn raw(&self) -> RawTime {
        Self::FIRST_RAW + Span::from_nanos(self.mono.load(Ordering::SeqCst))
    }

    fn identity(&self) -> &ClockIdentity {
        &self.identity
    }

    fn readings(&self) -> Readings {
        let Stamp { wall, mono, raw } = self.stamp();
        Readings { wall, mono, raw, boot: mono + Span::from_nanos(self.total_sleep.load(Ordering::SeqCst)) }
    }

    fn epoch(&self) -> u32 {
        self.epoch.load(Ordering::SeqCst)
    }

    fn begin_epoch(&self) {
        self.epoch.fetch_add(1, Ordering::SeqCst);
    }

    fn wall_epoch(&self) -> u32 {
        self.wall_epoch.load(Ordering::SeqCst)
    }

    fn begin_wall_epoch(&self) {
        self.wall_epoch.fetch_add(1, Ordering::SeqCst);
    }

    fn last_step(&self) -> Option<Span> {
        let step = self.last_step.load(Ordering::SeqCst);
        (step != 0).then(|| Span::from_nanos(step))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_moves_wall_clock_only() {
        let clock = ManualClock::new(WallTime::from_unix_nanos(5), ClockIdentity::new("b", "c"));
        clock.advance(Span::from_nanos(10));
        clock.step_wall(Span::from_nanos(-100));
        assert_eq!(clock.wall(), WallTime::from_unix_nanos(-85));
        assert_eq!(clock.mono(), MonoTime::from_nanos(10));
        assert_eq!(clock.raw(), ManualClock::FIRST_RAW + Span::from_nanos(10));
        assert_eq!((clock.wall_epoch(), clock.last_step()), (1, Some(Span::from_nanos(-100))));
        assert_eq!(clock.epoch(), 0, "the free-running clock was not interrupted");
    }
}
