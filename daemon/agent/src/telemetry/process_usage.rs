//! CPU time and memory of the agent itself.

use peernet_clock::{MonoTime, SharedClock, Span};
use rustix::param::page_size;
use rustix::time::{ClockId, clock_gettime};

/// CPU time and memory of this process.
#[derive(Debug)]
pub(super) struct ProcessUsage {
    clock: SharedClock,
    /// Time of the last reading of the CPU time, and its value.
    last: Option<(MonoTime, Span)>,
}

impl ProcessUsage {
    pub(super) const fn new(clock: SharedClock) -> Self {
        Self { clock, last: None }
    }

    /// Returns the CPU time since the last call as a share of one core; `None` at the first call.
    pub(super) fn cpu_share(&mut self) -> Option<f64> {
        let spent = clock_gettime(ClockId::ProcessCPUTime);
        let spent = Span::from_seconds(spent.tv_sec) + Span::from_nanos(spent.tv_nsec);
        let now = self.clock.mono();
        let (last_time, last_spent) = self.last.replace((now, spent))?;
        let passed = (now - last_time).seconds();
        (passed > 0.0).then(|| (spent - last_spent).seconds() / passed)
    }

    /// Returns the resident memory in bytes.
    pub(super) fn memory_bytes() -> Option<u64> {
        // proc_pid_statm(5): the second field is the resident pages.
        let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
        let pages: u64 = statm.split_ascii_whitespace().nth(1)?.parse().ok()?;
        Some(pages * page_size() as u64)
    }
}
