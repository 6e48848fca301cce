//! A rehearsal that begins when the test says so: nothing depends on how fast the machine is.

use std::sync::OnceLock;

use peernet_clock::{
    Clock, ClockFaults, ClockIdentity, FaultyClock, MonoTime, RawTime, Readings, SharedClock, Span, WallTime,
};

/// A right clock until it is told to go wrong.
#[derive(Debug)]
pub(crate) struct Late {
    right: SharedClock,
    rehearsed: OnceLock<FaultyClock>,
}

impl Late {
    pub(crate) fn new(right: SharedClock) -> Self {
        Self { right, rehearsed: OnceLock::new() }
    }

    /// Goes wrong from now on.
    pub(crate) fn go_wrong(&self, how: ClockFaults) {
        let identity = self.right.identity().clone();
        let wrong = FaultyClock::new(SharedClock::clone(&self.right), identity, how);
        self.rehearsed.set(wrong).expect("once");
    }

    fn now(&self) -> &dyn Clock {
        match self.rehearsed.get() {
            Some(rehearsed) => rehearsed,
            None => &*self.right,
        }
    }
}

impl Clock for Late {
    fn wall(&self) -> WallTime {
        self.now().wall()
    }

    fn mono(&self) -> MonoTime {
        self.right.mono()
    }

    fn raw(&self) -> RawTime {
        self.now().raw()
    }

    fn identity(&self) -> &ClockIdentity {
        self.right.identity()
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

    fn adopt(&self, system: WallTime) -> WallTime {
        self.now().adopt(system)
    }

    fn rehearsal(&self) -> Option<&ClockFaults> {
        self.now().rehearsal()
    }
}
