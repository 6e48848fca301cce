//! Resident memory of this process.

/// Resident memory of this process, bytes; memory of a GPU and of other processes is not included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessMemory {
    /// Resident memory now.
    pub resident: u64,
    /// Largest resident memory since the process started.
    pub peak: u64,
}

impl ProcessMemory {
    /// Reads the memory from the kernel; `None` if it cannot be read.
    pub fn read() -> Option<Self> {
        Self::parse(&std::fs::read_to_string("/proc/self/status").ok()?)
    }

    /// Parses `/proc/PID/status`; see proc_pid_status(5).
    fn parse(status: &str) -> Option<Self> {
        let bytes = |key: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(key))?;
            line.trim().strip_suffix(" kB")?.parse::<u64>().ok()?.checked_mul(1024)
        };
        Some(Self { resident: bytes("VmRSS:")?, peak: bytes("VmHWM:")? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_read_in_bytes() {
        let status = "Name:\tcat\nVmHWM:\t    2048 kB\nVmRSS:\t    1024 kB\nThreads:\t1\n";
        assert_eq!(ProcessMemory::parse(status), Some(ProcessMemory { resident: 1 << 20, peak: 2 << 20 }));
        // A kernel thread has no memory of its own.
        assert_eq!(ProcessMemory::parse("Name:\tkthreadd\n"), None);
        assert!(
            ProcessMemory::read().is_some_and(|memory| memory.resident > 1 << 20),
            "this process uses more than 1 MiB"
        );
    }
}
