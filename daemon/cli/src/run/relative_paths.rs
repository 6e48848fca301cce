//! Hint at the folder in which relative paths start.

use std::env::current_dir;

/// Returns the hint for paths that do not exist.
pub(super) fn base_hint() -> String {
    let current_folder =
        current_dir().map_or_else(|_| String::new(), |folder| format!(", {}", folder.display()));
    format!(
        "relative paths start at the current folder{current_folder}: start the program in the folder from which they lead to the files, or write absolute paths"
    )
}

/// Error of the operating system for a file that does not exist.
const NO_SUCH_FILE: &str = ": No such file or directory";

/// Returns the hint if one of these sentences says that a file with a relative path does not exist.
pub(super) fn hint_at_relative_paths<'a>(mut sentences: impl Iterator<Item = &'a str>) -> Option<String> {
    sentences.any(misses_relative_path).then(base_hint)
}

/// Returns whether a sentence says that a file does not exist and names the file by a relative
/// path. The folder in which the program was started does not matter for an absolute path.
fn misses_relative_path(sentence: &str) -> bool {
    let Some((before, _)) = sentence.split_once(NO_SUCH_FILE) else { return false };
    let clause = before.rsplit(": ").next().unwrap_or_default();
    // A path may contain spaces, so an absolute path begins with any word of the clause.
    let begins_absolute_path = |word: &str| word.trim_start_matches(['"', '\'', '`', '(']).starts_with('/');
    !clause.split_whitespace().any(begins_absolute_path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hint_is_given_for_relative_paths_only() {
        let hint = |text| hint_at_relative_paths(std::iter::once(text)).is_some();
        assert!(hint("pipeline.sensor: cannot read pictures/a.jpg: No such file or directory (os error 2)"));
        assert!(!hint("cannot read /data/a.jpg: No such file or directory (os error 2)"));
        assert!(!hint("cannot read \"/data/a.jpg\": No such file or directory"));
        assert!(!hint("cannot read /data/my pictures/a.jpg: No such file or directory (os error 2)"));
        assert!(!hint("cannot read \"/data/my pictures/a.jpg\": No such file or directory"));
        assert!(hint("cannot use /data/run.toml: cannot read my pictures/a.jpg: No such file or directory"));
        assert!(!hint("connection refused"));
    }
}
