//! The sensors, one file per kind.

mod folder;
mod images;
mod labels;
mod synthetic;

use crate::{Sensor, SensorConfig, SensorError};
use images::Images;
use synthetic::Synthetic;

/// Opens the sensor that a configuration describes.
///
/// # Errors
/// When the configuration contradicts itself, or what it names is not there.
pub fn open(config: &SensorConfig) -> Result<Box<dyn Sensor>, SensorError> {
    Ok(match config {
        SensorConfig::Images { path, order, seed, repeat } => {
            Box::new(Images::open(path, *order, *seed, *repeat)?)
        }
        SensorConfig::Synthetic { size_bytes, sizes_bytes, seed } => {
            Box::new(Synthetic::open(*size_bytes, sizes_bytes, *seed)?)
        }
    })
}
