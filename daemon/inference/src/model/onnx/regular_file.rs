//! Opening of files in a model's folder.

use std::fs::File;
use std::io;
use std::path::Path;

/// Opens a regular file that is not empty.
///
/// Opening or reading another kind of file may block for ever. This would also block the listing of a folder of models.
///
/// # Errors
/// If the file is not regular, is empty, or cannot be opened.
pub(super) fn open(file: &Path) -> io::Result<File> {
    // The type is checked before the file is opened, because opening a named pipe waits for a writer.
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    // Files of the kernel, such as /proc/kmsg, are regular and have the length 0, but reading such a file may wait for
    // content.
    if metadata.len() == 0 {
        return Err(io::Error::other("it is empty"));
    }
    File::open(file)
}
