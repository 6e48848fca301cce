//! Opening of files in a model's folder.

use std::fs::File;
use std::io;
use std::path::Path;

/// Opens a regular file that is not empty.
///
/// Other files may block for ever when they are opened or read, and would block the listing of a folder of models.
///
/// # Errors
/// If it is not a regular file, is empty, or cannot be opened.
pub(super) fn open(file: &Path) -> io::Result<File> {
    // The type is checked before opening, because opening a named pipe waits for its writer.
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    // Files of the kernel, such as /proc/kmsg, are regular and empty, and reading may wait for content.
    if metadata.len() == 0 {
        return Err(io::Error::other("it is empty"));
    }
    File::open(file)
}
