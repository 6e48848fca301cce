//! What the host is made of.

use peernet_logger::stream::Hardware;
use sysinfo::{CpuRefreshKind, MemoryRefreshKind, System};

/// Describes this machine; what cannot be read stays empty.
pub(crate) fn hardware() -> Hardware {
    let mut description = Hardware {
        system: System::long_os_version().unwrap_or_default(),
        architecture: System::cpu_arch(),
        ..Hardware::default()
    };
    if let Ok(mut system) = System::new() {
        system.refresh_cpu_list(CpuRefreshKind::nothing());
        system.refresh_memory_specifics(MemoryRefreshKind::nothing().with_ram());
        description.cpu = system.cpus().first().map(|cpu| cpu.brand().trim().to_owned()).unwrap_or_default();
        description.cores = u32::try_from(system.cpus().len()).unwrap_or(u32::MAX);
        description.memory_bytes = system.total_memory();
    }
    description
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_has_cores_and_memory() {
        let hardware = hardware();
        assert!(hardware.cores >= 1 && hardware.memory_bytes > 64 << 20, "{hardware:?}");
        assert!(!hardware.architecture.is_empty() && !hardware.system.is_empty(), "{hardware:?}");
    }
}
