//! Masks: the expected answers of segmentations.

use std::io;
use std::path::Path;

use peernet_imaging::{Picture, decode_class_mask};

use crate::{SensorError, file};

/// Reads the mask of a labelled picture: the numbers of the classes of its pixels, as grey pixels.
///
/// # Errors
/// If the file cannot be read, or is no indexed or grey PNG file of at most 8 bits.
pub fn read_mask(path: &Path) -> Result<Picture, SensorError> {
    let bytes = file::read(path)?;
    decode_class_mask(&bytes)
        .map_err(|error| SensorError::Read { path: path.to_owned(), error: io::Error::other(error) })
}
