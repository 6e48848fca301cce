//! Files that are found in a folder of models.

use std::fs::File;
use std::io;
use std::path::Path;

/// Opens a regular file. Anything else may never end or never begin, and would hold up who lists a folder of models.
///
/// # Errors
/// When it is none or cannot be opened.
pub(super) fn open(file: &Path) -> io::Result<File> {
    // Before it is opened: to open a pipe waits for its writer.
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    File::open(file)
}
