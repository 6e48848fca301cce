//! CPU time and memory of the agent itself.

use peernet_clock::{MonoTime, SharedClock, Span};
use rustix::param::page_size;
use rustix::time::{ClockId, clock_gettime};

/// CPU time and memory of this process.
#[derive(Debug)]
pub(super) struct ProcessUsage {
    clock: SharedClock,
    /// Time of the last reading of the CPU time, and its value.
    last_reading: Option<(MonoTime, Span)>,
}

impl ProcessUsage {
    pub(super) const fn new(clock: SharedClock) -> Self {
        Self { clock, last_reading: None }
    }

    /// Returns the CPU time since the last call as a share of one core; `None` at the first call.
    pub(super) fn cpu_share(&mut self) -> Option<f64> {
        let cpu_time = clock_gettime(ClockId::ProcessCPUTime);
        let cpu_time = Span::from_seconds(cpu_time.tv_sec) + Span::from_nanos(cpu_time.tv_nsec);
        let now = self.clock.mono();
        let (last_time, last_cpu_time) = self.last_reading.replace((now, cpu_time))?;
        let elapsed = (now - last_time).seconds();
        (elapsed > 0.0).then(|| (cpu_time - last_cpu_time).seconds() / elapsed)
    }

    /// Returns the resident memory in bytes.
    pub(super) fn memory_bytes() -> Option<u64> {
        // proc_pid_statm(5): the second field is the resident pages.
        let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
        let pages: u64 = statm.split_ascii_whitespace().nth(1)?.parse().ok()?;
        Some(pages * page_size() as u64)
    }
}
