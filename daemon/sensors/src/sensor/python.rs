//! Sensor kind `python`: a custom object with `sample()`.

use std::collections::BTreeMap;

use peernet_clock::{SharedClock, Span};
pub use peernet_external::python::PythonConfig;
use peernet_external::python::{PythonObject, Role};
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;

use super::{SensorConfig, SensorKind};
use crate::{Sensor, SensorError};

/// Sensor that requests each sample from a Python object.
struct PythonSensor {
    name: String,
    object: PythonObject,
}

impl SensorKind for PythonConfig {
    /// Starts the Python process and creates the object in it.
    fn open(&self, clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError> {
        let name = format!("sensor {}", self.object);
        // Only a model is configured for a device.
        let device = None;
        let object = PythonObject::start(self, Role::Sensor, &name, device, clock)?;
        Ok(Box::new(PythonSensor { name: self.object.clone(), object }))
    }

    fn check(&self, clock: &SharedClock) -> Result<(), SensorError> {
        Ok(PythonObject::check(self, clock)?)
    }

    fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        Some(&mut self.env)
    }
}

impl SensorConfig {
    /// Returns the configuration of a Python object; [`PythonConfig`] describes `pickle`.
    pub fn python_object(object: &str, pickle: bool) -> Self {
        PythonConfig { pickle, ..PythonConfig::new(object) }.into()
    }
}

impl Sensor for PythonSensor {
    fn sample(&mut self, recorder: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let call = self.object.call(&[]);
        let started_at = call.times.started_at;
        if let Some(from) = call.times.restart_began_at {
            recorder.record_timer(stage::CAPTURE_RESTART, from, started_at);
        }
        // Statistics group nodes by name, so the name must differ from `ipc`, the stage of a model.
        recorder.record_timer(stage::CAPTURE_IPC, started_at, started_at + call.times.overhead());
        let Some(parts) = call.result? else { return Ok(None) };
        Ok(Some(Sample { parts, source: self.name.clone(), label: None }))
    }

    fn resets(&self) -> bool {
        self.object.resets()
    }

    fn reset(&mut self) -> Result<(), SensorError> {
        Ok(self.object.reset()?)
    }

    fn advances(&self) -> bool {
        self.object.advances()
    }

    fn advance(&mut self, time: Span) -> Result<(), SensorError> {
        Ok(self.object.advance(time)?)
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.object.description().facts("Sensor")
    }
}
