//! `python`: an object of the user's own with `infer(x)`.

mod config;

pub use config::PythonModelConfig;

use std::sync::{Mutex, PoisonError};

use peernet_clock::SharedClock;
use peernet_external::python::{PythonError, PythonObject, Role, Stage};
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;

use crate::{InferenceError, LoadError, Model, Worker};

/// A Python object, once for each worker.
pub(crate) struct Python {
    config: PythonModelConfig,
    clock: SharedClock,
    facts: Vec<(String, String)>,
    /// The first one, which was started to see whether it can be.
    first: Mutex<Option<PythonObject>>,
}

impl Python {
    /// Everything that can be found wrong without running the user's code.
    pub(crate) fn check(config: &PythonModelConfig, clock: &SharedClock) -> Result<(), LoadError> {
        Ok(PythonObject::check(&config.process(), clock)?)
    }

    /// Starts one process.
    pub(crate) fn load(config: &PythonModelConfig, clock: &SharedClock) -> Result<Self, LoadError> {
        let object = start(config, clock)?;
        let facts = object.about().facts("Model");
        Ok(Self {
            config: config.clone(),
            clock: SharedClock::clone(clock),
            facts,
            first: Mutex::new(Some(object)),
        })
    }
}

impl Model for Python {
    fn worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        let first = self.first.lock().unwrap_or_else(PoisonError::into_inner).take();
        let object = first.map_or_else(|| start(&self.config, &self.clock), Ok)?;
        Ok(Box::new(PythonWorker { model: self.config.name.to_string(), object }))
    }

    fn device(&self) -> String {
        self.config.device.clone()
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.facts.clone()
    }
}

fn start(config: &PythonModelConfig, clock: &SharedClock) -> Result<PythonObject, PythonError> {
    let name = format!("model {}", config.name);
    PythonObject::start(&config.process(), Role::Model, &name, Some(&config.device), clock)
}

struct PythonWorker {
    model: String,
    object: PythonObject,
}

impl Worker for PythonWorker {
    fn infer(&mut self, sample: &Sample, log: &mut Recorder) -> Result<Sample, InferenceError> {
        let called = self.object.call(&sample.parts);
        let begun = called.times.begun;
        if let Some(from) = called.times.restarted {
            log.timed(stage::RESTART, from, begun);
        }
        log.timed(stage::IPC, begun, begun + called.times.border());
        let has_inferred = called.times.stages.iter().any(|(own, ..)| *own == Stage::Infer);
        for (own, from, to) in called.times.stages {
            let name = match own {
                Stage::Preprocess => stage::PREPROCESSING,
                Stage::Infer => stage::INFERENCE,
                Stage::Postprocess => stage::POSTPROCESSING,
                Stage::Sample => stage::CAPTURE,
            };
            log.timed(name, from, to);
        }
        let failed = |reason| InferenceError::Failed { model: self.model.clone(), reason };
        let parts = called.result.map_err(|error| match error {
            // It took the sample.
            PythonError::Value(reason) if has_inferred => failed(format!("its answer: {reason}")),
            PythonError::Value(reason) => {
                let (model, sample) = (self.model.clone(), sample.source.clone());
                InferenceError::Input { model, sample, reason }
            }
            error => failed(error.to_string()),
        })?;
        let parts = parts.ok_or_else(|| failed("it answered as a sensor at its end does".to_owned()))?;
        Ok(Sample { parts, source: String::new(), label: None })
    }
}
