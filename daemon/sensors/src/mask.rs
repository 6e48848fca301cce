//! Masks: the expected answers of segmentations.

use std::io;
use std::path::Path;

use peernet_imaging::{Picture, decode_class_mask};
use peernet_sample::Part;

use crate::{SensorError, file};

/// Reads the mask of a labelled picture: grey pixels whose values are class numbers.
///
/// # Errors
/// If the file cannot be read, or is not an indexed or grey PNG file of at most 8 bits per pixel.
pub fn read_mask(path: &Path) -> Result<Part, SensorError> {
    let bytes = file::read(path)?;
    decode_class_mask(&bytes)
        .map(Picture::into_part)
        .map_err(|error| SensorError::Read { path: path.to_owned(), error: io::Error::other(error) })
}
