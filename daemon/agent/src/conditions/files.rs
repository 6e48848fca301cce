//! Reads the kernel's files. A file disappears with its device, so a missing file is not an error.

use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Returns the text of a file without surrounding white space; `None` if it cannot be read.
pub(super) fn read_text(path: &Path) -> Option<String> {
    Some(fs::read_to_string(path).ok()?.trim().to_owned())
}

/// Returns the parsed text of a file; `None` if it cannot be read or parsed.
pub(super) fn read_value<T: FromStr>(path: &Path) -> Option<T> {
    read_text(path)?.parse().ok()
}

/// Returns the entries of a folder whose names begin with `prefix`, in the order of their names.
pub(super) fn list_entries(folder: &Path, prefix: &str) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let has_prefix =
        |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix));
    let mut paths: Vec<PathBuf> =
        entries.filter_map(|entry| Some(entry.ok()?.path())).filter(has_prefix).collect();
    paths.sort_unstable();
    paths
}

/// Returns the folders `cpu0`, `cpu1` and so on in sysfs, without `cpufreq` and `cpuidle`.
pub(super) fn processors(sys: &Path) -> Vec<PathBuf> {
    let is_numbered = |path: &PathBuf| {
        let number = path.file_name().and_then(|name| name.to_str()?.strip_prefix("cpu"));
        number.is_some_and(|number| !number.is_empty() && number.bytes().all(|digit| digit.is_ascii_digit()))
    };
    list_entries(&sys.join("devices/system/cpu"), "cpu").into_iter().filter(is_numbered).collect()
}

/// Returns the number after `key:` in a text of lines such as `key: number`, for example /proc/meminfo.
pub(super) fn number_after_key(text: &str, key: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
    line.split_ascii_whitespace().next()?.parse().ok()
}
