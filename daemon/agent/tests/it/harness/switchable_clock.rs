//! A clock whose faults begin when a test injects them, so that no test depends on the speed of the machine.

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
        let faulty_clock = FaultyClock::new(SharedClock::clone(&self.true_clock), identity, faults);
        self.faulty_clock.set(faulty_clock).expect("faults are injected once");
    }

    fn current(&self) -> &dyn Clock {
        match self.faulty_clock.get() {
            Some(faulty_clock) => faulty_clock,
            None => &*self.true_clock,
        }
    }
}

impl Clock for SwitchableClock {
    fn wall(&self) -> WallTime {
        self.current().wall()
    }

    fn mono(&self) -> MonoTime {
        self.true_clock.mono()
    }

    fn raw(&self) -> RawTime {
        self.current().raw()
    }

    fn identity(&self) -> &ClockIdentity {
        self.true_clock.identity()
    }

    fn readings(&self) -> Readings {
        self.current().readings()
    }

    fn epoch(&self) -> u32 {
        self.current().epoch()
    }

    fn begin_epoch(&self) {
        self.current().begin_epoch();
    }

    fn wall_epoch(&self) -> u32 {
        self.current().wall_epoch()
    }

    fn begin_wall_epoch(&self) {
        self.current().begin_wall_epoch();
    }

    fn last_step(&self) -> Option<Span> {
        self.current().last_step()
    }

    fn apply_faults(&self, system: WallTime) -> WallTime {
        self.current().apply_faults(system)
    }

    fn injected_faults(&self) -> Option<&ClockFaults> {
        self.current().injected_faults()
    }
}
