//! Errors of writing results.

use std::fs::File;
use std::io::Write;
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

/// Writes a complete file, replacing an existing one. A file that cannot be written completely is
/// removed. An existing file that cannot be opened stays as it is.
///
/// # Errors
/// If the file cannot be written.
pub fn write_file(path: &Path, content: &[u8]) -> Result<(), WriteError> {
    let mut file = File::create(path).map_err(WriteError::at(path))?;
    file.write_all(content).map_err(|error| {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn existing_file_that_cannot_be_opened_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("series.png");
        // Nobody can open this regular file for writing, not even root.
        std::os::unix::fs::symlink("/proc/sys/kernel/osrelease", &path).expect("a link");
        let error = write_file(&path, b"new").expect_err("the file is read-only").to_string();
        assert!(error.contains("series.png"), "{error}");
        assert!(path.is_file(), "the link is not removed");
    }

    #[test]
    fn device_that_cannot_be_written_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("series.png");
        std::os::unix::fs::symlink("/dev/full", &path).expect("a link");
        let error = write_file(&path, b"new").expect_err("the disk is full").to_string();
        assert!(error.contains("No space left"), "{error}");
        assert!(path.exists(), "the link is not removed");
    }
}
