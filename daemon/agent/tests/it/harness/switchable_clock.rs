//! A clock fault that begins when the test wants it, so that nothing depends on the speed of the machine.

use std::sync::OnceLock;

use peernet_clock::{
    Clock, ClockFaults, ClockIdentity, FaultyClock, MonoTime, RawTime, Readings, SharedClock, Span, WallTime,
};

/// A clock without faults, into which faults are injected on request.
#[derive(Debug)]
pub(crate) struct SwitchableClock {
    true_clock: SharedClock,
    faulty_clock: OnceLock<FaultyClock>,
}

impl SwitchableClock {
    pub(crate) fn new(true_clock: SharedClock) -> Self {
        Self { true_clock, faulty_clock: OnceLock::new() }
    }

    /// Injects faults from now on.
    pub(crate) fn inject(&self, faults: ClockFaults) {
        let identity = self.true_clock.identity().clone();
        let wrong = FaultyClock::new(SharedClock::clone(&self.true_clock), identity, faults);
        self.faulty_clock.set(wrong).expect("once");
    }

    fn now(&self) -> &dyn Clock {
        match self.faulty_clock.get() {
            Some(faulty_clock) => faulty_clock,
            None => &*self.true_clock,
        }
    }
}

impl Clock for SwitchableClock {
    fn wall(&self) -> WallTime {
        self.now().wall()
    }

    fn mono(&self) -> MonoTime {
        self.true_clock.mono()
    }

    fn raw(&self) -> RawTime {
        self.now().raw()
    }

    fn identity(&self) -> &ClockIdentity {
        self.true_clock.identity()
    }

    fn readings(&self) -> Readings {
        self.now().readings()
    }

    fn epoch(&self) -> u32 {
        self.now().epoch()
    }

    fn begin_epoch(&self) {
        self.now().begin_epoch();
    }

    fn wall_epoch(&self) -> u32 {
        self.now().wall_epoch()
    }

    fn begin_wall_epoch(&self) {
        self.now().begin_wall_epoch();
    }

    fn last_step(&self) -> Option<Span> {
        self.now().last_step()
    }

    fn apply_faults(&self, system: WallTime) -> WallTime {
        self.now().apply_faults(system)
    }

    fn injected_faults(&self) -> Option<&ClockFaults> {
        self.now().injected_faults()
    }
}
