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

/// Returns the hint if one of these sentences says that a file does not exist.
pub(super) fn base_hint_if_missing<'a>(mut sentences: impl Iterator<Item = &'a str>) -> Option<String> {
    sentences.any(|sentence| sentence.contains("No such file or directory")).then(base_hint)
}
