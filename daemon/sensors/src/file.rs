//! Reading of pictures and masks from files.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use peernet_external::exec::MAX_SAMPLE_BYTES;

use crate::SensorError;

/// Reads a whole file of at most [`MAX_SAMPLE_BYTES`].
///
/// # Errors
/// If the file is larger or cannot be read.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, SensorError> {
    let read_error = |error| SensorError::Read { path: path.to_owned(), error };
    let file = File::open(path).map_err(read_error)?;
    let too_large_error = || {
        let reason = format!("it has more than {MAX_SAMPLE_BYTES} bytes, the largest size of a sample");
        Err(read_error(io::Error::new(io::ErrorKind::FileTooLarge, reason)))
    };
    let length = file.metadata().map_err(read_error)?.len();
    if length > MAX_SAMPLE_BYTES {
        return too_large_error();
    }
    let mut bytes = Vec::with_capacity(length as usize);
    // The limit applies again, because the file may have grown.
    file.take(MAX_SAMPLE_BYTES + 1).read_to_end(&mut bytes).map_err(read_error)?;
    if bytes.len() as u64 > MAX_SAMPLE_BYTES { too_large_error() } else { Ok(bytes) }
}
