//! CPU time of the agent itself.

use peernet_clock::{MonoTime, SharedClock, Span};
use rustix::time::{ClockId, clock_gettime};

/// CPU time of this process.
#[derive(Debug)]
pub(super) struct ProcessCpuTime {
    clock: SharedClock,
    /// Time of the last reading of the CPU time, and its value.
    last_reading: Option<(MonoTime, Span)>,
}

impl ProcessCpuTime {
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
}
