//! Masks: the expected answers of segmentations.

use std::fs;
use std::io;
use std::path::Path;

use peernet_imaging::{Picture, decode_class_mask};

use crate::SensorError;

/// Reads the mask of a labelled picture: the numbers of the classes of its pixels, as grey pixels.
///
/// # Errors
/// If the file cannot be read, or is no indexed or grey PNG file of at most 8 bits.
pub fn read_mask(file: &Path) -> Result<Picture, SensorError> {
    let unreadable = |error| SensorError::Read { path: file.to_owned(), error };
    let bytes = fs::read(file).map_err(unreadable)?;
    decode_class_mask(&bytes).map_err(|error| unreadable(io::Error::other(error)))
}
