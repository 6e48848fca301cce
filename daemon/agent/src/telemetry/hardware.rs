//! Hardware of the host.

use std::fs;
use std::path::{Path, PathBuf};

use peernet_stream::Hardware;
use sysinfo::{CpuRefreshKind, MemoryRefreshKind, System};

/// Returns the description of this machine; a field that cannot be read is empty.
pub(crate) fn hardware() -> Hardware {
    let mut description = Hardware {
        system: system(),
        architecture: System::cpu_arch(),
        gpus: gpus(Path::new("/proc")),
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

/// Returns the name of the operating system, such as a Linux distribution, and the version of its kernel.
fn system() -> String {
    let kernel = System::kernel_version().map(|release| format!("kernel {release}"));
    System::long_os_version().into_iter().chain(kernel).collect::<Vec<_>>().join(", ")
}

/// Returns the names of NVIDIA accelerators that their driver lists, in the order of the bus. On a Jetson, whose
/// accelerator is part of the board, the result is the name of the board.
fn gpus(proc: &Path) -> Vec<String> {
    let entries = fs::read_dir(proc.join("driver/nvidia/gpus")).into_iter().flatten();
    let mut cards: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    // Each folder is named after the address of its card on the bus.
    cards.sort_unstable();
    let cards: Vec<String> = cards
        .iter()
        .filter_map(|card| {
            let text = fs::read_to_string(card.join("information")).ok()?;
            let name = text.lines().find_map(|line| line.strip_prefix("Model:"))?.trim().to_owned();
            Some(name).filter(|name| !name.is_empty())
        })
        .collect();
    if !cards.is_empty() {
        return cards;
    }
    let board = fs::read_to_string(proc.join("device-tree/model")).unwrap_or_default();
    // Texts in a device tree end with a zero byte.
    let board = board.trim_end_matches('\0').trim();
    if board.contains("Jetson") { vec![board.to_owned()] } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accelerators_are_named_by_driver_or_board() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |path: &str, text: &str| {
            let path = folder.path().join(path);
            fs::create_dir_all(path.parent().expect("the file has a folder")).expect("writable");
            fs::write(path, text).expect("writable");
        };
        assert!(gpus(folder.path()).is_empty());
        write("device-tree/model", "Raspberry Pi 5 Model B Rev 1.0\0");
        assert!(gpus(folder.path()).is_empty());
        write("device-tree/model", "NVIDIA Jetson AGX Orin Developer Kit\0");
        assert_eq!(gpus(folder.path()), ["NVIDIA Jetson AGX Orin Developer Kit"]);
        // As written by driver 535.
        let card = |name: &str| format!("Model: \t\t {name}\nIRQ:   \t\t 177\nGPU UUID: \t GPU-0\n");
        write("driver/nvidia/gpus/0000:65:00.0/information", &card("NVIDIA A100-PCIE-40GB"));
        write("driver/nvidia/gpus/0000:17:00.0/information", &card("NVIDIA GeForce RTX 3090"));
        assert_eq!(gpus(folder.path()), ["NVIDIA GeForce RTX 3090", "NVIDIA A100-PCIE-40GB"]);
    }

    #[test]
    fn this_machine_has_cores_and_memory() {
        let hardware = hardware();
        assert!(hardware.cores >= 1 && hardware.memory_bytes > 64 << 20, "{hardware:?}");
        assert!(!hardware.architecture.is_empty(), "{hardware:?}");
        let release = fs::read_to_string("/proc/sys/kernel/osrelease").expect("the kernel shows its release");
        assert!(hardware.system.ends_with(&format!(", kernel {}", release.trim())), "{hardware:?}");
    }
}
