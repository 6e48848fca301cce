//! The kernel's clocksource.

use std::path::{Path, PathBuf};

/// Path, below sysfs, of the file that contains the clocksource's name (Linux documentation,
/// `Documentation/ABI/testing/sysfs-devices-system-clocksource`).
const FILE: &str = "devices/system/clocksource/clocksource0/current_clocksource";

/// Maximum number of characters of the name that are kept.
const MAX_NAME: usize = 64;

/// Reader of the current clocksource's name.
#[derive(Debug)]
pub(crate) struct Clocksource {
    file: PathBuf,
}

impl Clocksource {
    /// Creates a reader for the system whose sysfs is at `sys`.
    pub(crate) fn from_sysfs(sys: &Path) -> Self {
        Self { file: sys.join(FILE) }
    }

    /// Returns the name; empty if it cannot be read, as in some containers.
    pub(crate) fn name(&self) -> String {
        let text = std::fs::read_to_string(&self.file).unwrap_or_default();
        text.trim().chars().take(MAX_NAME).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn clocksource_is_read_again_each_time() {
        let sys = tempfile::tempdir().expect("a folder");
        let clocksource = Clocksource::from_sysfs(sys.path());
        assert_eq!(clocksource.name(), "");
        let file = sys.path().join(FILE);
        fs::create_dir_all(file.parent().expect("the file has a folder")).expect("made");
        for name in ["tsc", "kvm-clock"] {
            fs::write(&file, format!("{name}\n")).expect("written");
            assert_eq!(clocksource.name(), name);
        }
    }
}
