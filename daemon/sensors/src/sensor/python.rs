//! `python`: an object of the user's own with `sample()`.

use peernet_clock::SharedClock;
use peernet_external::python::{PythonConfig, PythonObject, Role};
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;

use crate::{Sensor, SensorError};

/// A Python object that is asked for each sample.
pub(super) struct Python {
    name: String,
    object: PythonObject,
}

impl Python {
    /// Starts its process and makes the object.
    pub(super) fn open(config: &PythonConfig, clock: &SharedClock) -> Result<Self, SensorError> {
        let name = format!("sensor {}", config.object);
        let object = PythonObject::start(config, Role::Sensor, &name, None, clock)?;
        Ok(Self { name: config.object.clone(), object })
    }
}

impl Sensor for Python {
    fn sample(&mut self, log: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let called = self.object.call(&[]);
        let begun = called.times.begun;
        if let Some(from) = called.times.restarted {
            log.timed(stage::CAPTURE_RESTART, from, begun);
        }
        log.timed(stage::CAPTURE_IPC, begun, begun + called.times.border());
        let Some(parts) = called.result? else { return Ok(None) };
        Ok(Some(Sample { parts, source: self.name.clone(), label: None }))
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.object.about().facts("Sensor")
    }
}
