//! Sensor kind `python`: a custom object with `sample()`.

use std::collections::BTreeMap;

use peernet_clock::{SharedClock, Span};
pub use peernet_external::python::PythonConfig;
use peernet_external::python::{PythonObject, Role};
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;

use super::{SensorConfig, SensorKind};
use crate::{Sensor, SensorError};

/// Python object that is asked for each sample.
struct Python {
    name: String,
    object: PythonObject,
}

impl SensorKind for PythonConfig {
    /// Starts its process and creates the object.
    fn open(&self, clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError> {
        let name = format!("sensor {}", self.object);
        let object = PythonObject::start(self, Role::Sensor, &name, None, clock)?;
        Ok(Box::new(Python { name: self.object.clone(), object }))
    }

    fn check(&self, clock: &SharedClock) -> Result<(), SensorError> {
        Ok(PythonObject::check(self, clock)?)
    }

    fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        Some(&mut self.env)
    }
}

impl SensorConfig {
    /// Returns the configuration of a Python object; `pickle` as in [`PythonConfig`].
    pub fn python_object(object: &str, pickle: bool) -> Self {
        PythonConfig { pickle, ..PythonConfig::new(object) }.into()
    }
}

impl Sensor for Python {
    fn sample(&mut self, recorder: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let called = self.object.call(&[]);
        let started_at = called.times.started_at;
        if let Some(from) = called.times.restarted_at {
            recorder.record_timer(stage::CAPTURE_RESTART, from, started_at);
        }
        // Statistics group nodes by name, so this stage must not have the name of the model's `ipc`.
        recorder.record_timer(stage::CAPTURE_IPC, started_at, started_at + called.times.overhead());
        let Some(parts) = called.result? else { return Ok(None) };
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
