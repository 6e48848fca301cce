//! Errors of writing results.

use std::path::{Path, PathBuf};

/// Error of writing a file of results.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {reason}", path.display())]
pub struct WriteError {
    /// Path of the file.
    pub path: PathBuf,
    /// Cause, as text.
    pub reason: String,
}

impl WriteError {
    /// Returns a function that turns an error of writing the file at `path` into a [`WriteError`].
    pub fn at<E: std::fmt::Display>(path: &Path) -> impl FnOnce(E) -> Self {
        move |error| Self { path: path.to_owned(), reason: error.to_string() }
    }
}

/// Writes a complete file, replacing an existing one. A file that cannot be written completely is removed.
///
/// # Errors
/// If the file cannot be written.
pub fn write_file(path: &Path, content: &[u8]) -> Result<(), WriteError> {
    std::fs::write(path, content).map_err(|error| {
        let mut error = WriteError::at(path)(error);
        // An incomplete picture or table would look like a result. A pipe or a device at `path` must stay, so only
        // regular files are removed.
        if path.is_file()
            && let Err(removal) = std::fs::remove_file(path)
        {
            error.reason = format!("{}; the incomplete file cannot be removed: {removal}", error.reason);
        }
        error
    })
}
