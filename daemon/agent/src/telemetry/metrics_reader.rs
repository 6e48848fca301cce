//! Reads the host's metrics.

use std::sync::Arc;

use peernet_clock::SharedClock;
use peernet_inference::{Bank, LoadedModels, ProcessMemory};
use peernet_stream::{HostMetrics, ModelMetrics};
use sysinfo::{Components, CpuRefreshKind, MemoryRefreshKind, System};

use super::process_cpu_time::ProcessCpuTime;

/// Reader of the metrics. The reader keeps state, because a share of CPU time is a difference between two readings.
#[derive(Debug)]
pub(super) struct MetricsReader {
    bank: Arc<Bank>,
    system: Option<System>,
    temperatures: Option<Components>,
    process_cpu_time: ProcessCpuTime,
    /// `true` after the first reading. A share of CPU time needs a previous reading.
    has_previous: bool,
}

impl MetricsReader {
    pub(super) fn new(clock: SharedClock, bank: Arc<Bank>) -> Self {
        let log_unavailable = |quantity: &str, error: sysinfo::Error| {
            tracing::info!(%error, "cannot read {quantity} on this host; this value is not shown");
        };
        Self {
            bank,
            system: System::new().map_err(|error| log_unavailable("processor and memory load", error)).ok(),
            temperatures: Components::new().map_err(|error| log_unavailable("temperatures", error)).ok(),
            process_cpu_time: ProcessCpuTime::new(clock),
            has_previous: false,
        }
    }

    pub(super) fn read(&mut self) -> HostMetrics {
        let LoadedModels { count: loaded, memory_bytes } = self.bank.loaded_models();
        let mut metrics = HostMetrics {
            agent_memory_bytes: ProcessMemory::read().map(|memory| memory.resident),
            agent_cpu: self.process_cpu_time.cpu_share(),
            models: Some(ModelMetrics { loaded, memory_bytes }),
            ..HostMetrics::default()
        };
        if let Some(system) = &mut self.system {
            system.refresh_cpu_specifics(CpuRefreshKind::nothing().with_usage());
            system.refresh_memory_specifics(MemoryRefreshKind::nothing().with_ram());
            metrics.cpu = self.has_previous.then(|| f64::from(system.global_cpu_usage()) / 100.0);
            metrics.memory_used_bytes = Some(system.used_memory());
            self.has_previous = true;
        }
        if let Some(temperatures) = &mut self.temperatures {
            // `true` removes sensors that no longer exist.
            temperatures.refresh(true);
            metrics.temperature_celsius = temperatures
                .iter()
                .filter_map(sysinfo::Component::temperature)
                // sysinfo returns NaN for a sensor that it cannot read.
                .filter(|celsius| celsius.is_finite())
                .max_by(f32::total_cmp)
                .map(f64::from);
        }
        metrics
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{ClockIdentity, SystemClock};
    use peernet_inference::OnnxRuntimeConfig;

    use super::*;

    #[test]
    fn metrics_are_within_possible_ranges() {
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let bank = Arc::new(Bank::new(Vec::new(), OnnxRuntimeConfig::default(), Arc::clone(&clock)));
        let mut metrics_reader = MetricsReader::new(clock, bank);
        let first_reading = metrics_reader.read();
        assert_eq!((first_reading.cpu, first_reading.agent_cpu), (None, None), "a share needs two readings");
        let second_reading = metrics_reader.read();
        assert!(second_reading.cpu.is_some_and(|share| (0.0..=1.0).contains(&share)), "{second_reading:?}");
        assert!(second_reading.agent_cpu.is_some_and(|share| share >= 0.0), "{second_reading:?}");
        assert!(second_reading.memory_used_bytes.is_some_and(|bytes| bytes > 1 << 20), "{second_reading:?}");
        assert!(
            second_reading.agent_memory_bytes.is_some_and(|bytes| bytes > 100 << 10),
            "{second_reading:?}"
        );
        assert_eq!(second_reading.models, Some(ModelMetrics { loaded: 0, memory_bytes: 0 }));
        assert_eq!(
            (second_reading.gpu, second_reading.power_watts),
            (None, None),
            "the agent does not read these values"
        );
    }
}
