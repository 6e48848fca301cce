//! Opening of files in a model's folder.

use std::fs::File;
use std::io;
use std::path::Path;

/// Opens a regular file.
///
/// Other files may block for ever when they are opened or read, and would block the listing of a folder of models.
///
/// # Errors
/// If it is not a regular file or cannot be opened.
pub(super) fn open(file: &Path) -> io::Result<File> {
    // The type is checked before opening, because opening a named pipe waits for its writer.
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    File::open(file)
}
