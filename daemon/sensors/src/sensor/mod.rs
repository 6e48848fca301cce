//! The sensors, one file per kind.

mod data_set;
mod exec;
mod folder;
mod images;
mod labels;
mod python;
mod synthetic;
mod text;

use peernet_clock::SharedClock;
use peernet_external::python::PythonObject;

use crate::{Sensor, SensorConfig, SensorError};
use exec::Exec;
use images::Images;
use python::Python;
use synthetic::Synthetic;
use text::Text;

/// Checks what can be checked of a sensor without running a user's code.
///
/// # Errors
/// When the configuration contradicts itself, or what it names is not there.
pub fn check(config: &SensorConfig, clock: &SharedClock) -> Result<(), SensorError> {
    match config {
        SensorConfig::Exec(config) => exec::check(config),
        SensorConfig::Python(config) => Ok(PythonObject::check(config, clock)?),
        config => open(config, clock).map(drop),
    }
}

/// Opens the sensor that a configuration describes; `clock` is what its deadlines are taken from.
///
/// # Errors
/// When the configuration contradicts itself, or what it names is not there.
pub fn open(config: &SensorConfig, clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError> {
    Ok(match config {
        SensorConfig::Images { path, order, seed, repeat, labels } => {
            Box::new(Images::open(path, *order, *seed, *repeat, labels.as_deref())?)
        }
        SensorConfig::Text { length, seed } => Box::new(Text::open(*length, *seed)?),
        SensorConfig::Exec(config) => Box::new(Exec::open(config, clock)?),
        SensorConfig::Python(config) => Box::new(Python::open(config, clock)?),
        SensorConfig::Synthetic { size_bytes, sizes_bytes, seed } => {
            Box::new(Synthetic::open(*size_bytes, sizes_bytes, *seed)?)
        }
    })
}
