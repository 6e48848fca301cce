//! What the kernel reads the time from.

use std::path::{Path, PathBuf};

/// The file that names it. Linux documentation, `Documentation/ABI/testing/sysfs-devices-system-clocksource`.
const FILE: &str = "devices/system/clocksource/clocksource0/current_clocksource";

/// Clocks of the processor itself. All others are read through, or made up by, something below the kernel: in a virtual machine
/// the hypervisor, which may step and slew even the free-running clock.
const OF_PROCESSOR: [&str; 2] = ["tsc", "arch_sys_counter"];

/// Most bytes of a name that are kept.
const MAX_NAME: usize = 64;

/// Reads the name of the current clocksource, again and again.
#[derive(Debug)]
pub(crate) struct Clocksource {
    file: PathBuf,
}

impl Clocksource {
    /// That of the system whose sysfs is at `sys`.
    pub(crate) fn below(sys: &Path) -> Self {
        Self { file: sys.join(FILE) }
    }

    /// Returns its name; empty where it is not known, as in some containers.
    pub(crate) fn name(&self) -> String {
        let text = std::fs::read_to_string(&self.file).unwrap_or_default();
        text.trim().chars().take(MAX_NAME).collect()
    }
}

/// Returns in words what is to be said of a clocksource; `None` where there is nothing.
pub(crate) fn in_words(clocksource: &str) -> Option<String> {
    let is_plain = clocksource.is_empty() || OF_PROCESSOR.contains(&clocksource);
    (!is_plain).then(|| format!("clock supplied by the hypervisor ({clocksource})"))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn clocksource_other_than_processors_is_named() {
        let sys = tempfile::tempdir().expect("a folder");
        let clocksource = Clocksource::below(sys.path());
        assert_eq!((clocksource.name().as_str(), in_words("")), ("", None));
        let file = sys.path().join(FILE);
        fs::create_dir_all(file.parent().expect("it has one")).expect("made");
        for (name, words) in [
            ("tsc", None),
            ("arch_sys_counter", None),
            ("kvm-clock", Some("clock supplied by the hypervisor (kvm-clock)")),
        ] {
            fs::write(&file, format!("{name}\n")).expect("written");
            assert_eq!(clocksource.name(), name);
            assert_eq!(in_words(name).as_deref(), words);
        }
    }
}
