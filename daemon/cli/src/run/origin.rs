//! Where relative paths start, for whoever expected another folder.

use std::env::current_dir;

/// What to know of paths that lead nowhere.
pub(super) fn origin() -> String {
    let here = current_dir().map_or_else(|_| String::new(), |folder| format!(", {}", folder.display()));
    format!(
        "relative paths start at the current folder{here}: start where they lead to the files, or write absolute ones"
    )
}

/// The same, if one of these sentences says that a file is not there.
pub(super) fn origin_of_missing<'a>(mut sentences: impl Iterator<Item = &'a str>) -> Option<String> {
    sentences.any(|sentence| sentence.contains("No such file or directory")).then(origin)
}
