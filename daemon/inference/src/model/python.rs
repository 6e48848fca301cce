//! Model kind `python`: a custom object with `infer(x)`, with one process for each worker.

use std::collections::BTreeMap;
use std::num::NonZeroU64;
use std::sync::{Arc, Mutex, PoisonError};

use peernet_clock::SharedClock;
pub use peernet_external::python::PythonConfig;
use peernet_external::python::{PythonError, PythonObject, Role, Step};
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;

use super::{CommonSettings, Keys, LoadContext, ModelConfig, ModelKind, ModelTable};
use crate::{InferenceError, LoadError, Model, Requester, Worker};

impl ModelConfig {
    /// Returns the configuration of a Python object. [`PythonConfig`] describes `pickle` and `timeout_ms`; `None`
    /// stands for the default time limit.
    pub fn python_object(
        common: CommonSettings,
        object: &str,
        pickle: bool,
        timeout_ms: Option<NonZeroU64>,
    ) -> Self {
        let kind_settings = PythonConfig::new(object);
        let timeout_ms = timeout_ms.unwrap_or(kind_settings.timeout_ms);
        ModelTable { common, kind_settings: PythonConfig { pickle, timeout_ms, ..kind_settings } }.into()
    }
}

impl ModelKind for PythonConfig {
    fn keys_omitted_from_runs(&self) -> &'static [&'static str] {
        &["object", "folder", "python"]
    }

    fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        Some(&mut self.env)
    }

    fn remove_defaults(&self, keys: &mut Keys) {
        let default = Self::new(&self.object);
        if self.timeout_ms == default.timeout_ms {
            keys.remove("timeout_ms");
        }
        if self.start_timeout_ms == default.start_timeout_ms {
            keys.remove("start_timeout_ms");
        }
    }

    fn check(&self, _common: &CommonSettings, context: &LoadContext<'_>) -> Result<(), LoadError> {
        Ok(PythonObject::check(self, context.clock)?)
    }

    /// Starts one process.
    fn load(&self, common: &CommonSettings, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
        let (config, common, clock) = (self.clone(), common.clone(), SharedClock::clone(context.clock));
        let object = start(&config, &common, &clock)?;
        let facts = object.description().facts("Model");
        Ok(Arc::new(Python { config, common, clock, facts, first_object: Mutex::new(Some(object)) }))
    }
}

/// Python object that each worker creates in its own process.
struct Python {
    config: PythonConfig,
    common: CommonSettings,
    clock: SharedClock,
    facts: Vec<(String, String)>,
    /// Object that was created while the model was loaded, which shows that it can be created. The first worker takes
    /// this object.
    first_object: Mutex<Option<PythonObject>>,
}

impl Model for Python {
    fn create_worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        let first_object = self.first_object.lock().unwrap_or_else(PoisonError::into_inner).take();
        let object = first_object.map_or_else(|| start(&self.config, &self.common, &self.clock), Ok)?;
        Ok(Box::new(PythonWorker { model: self.common.name.to_string(), object }))
    }

    fn device(&self) -> String {
        self.common.device.clone()
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.facts.clone()
    }
}

fn start(
    config: &PythonConfig,
    common: &CommonSettings,
    clock: &SharedClock,
) -> Result<PythonObject, PythonError> {
    let name = format!("model {}", common.name);
    PythonObject::start(config, Role::Model, &name, Some(&common.device), clock)
}

struct PythonWorker {
    model: String,
    object: PythonObject,
}

impl Worker for PythonWorker {
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        let mut send_error = None;
        let call = self.object.call_with_partial_answers(&sample.parts, &mut |parts| {
            let partial_answer = Sample { parts, source: String::new(), label: None };
            send_error = requester.send_partial_answer(partial_answer).err();
            send_error.is_none()
        });
        let call_began_at = call.times.started_at;
        if let Some(from) = call.times.restart_began_at {
            recorder.record_timer(stage::RESTART, from, call_began_at);
        }
        // One node has the time of all transfers, before and after the steps. It begins with the call.
        recorder.record_timer(stage::IPC, call_began_at, call_began_at + call.times.overhead());
        let has_inferred = call.times.steps.iter().any(|(step, ..)| *step == Step::Infer);
        for (step, from, to) in call.times.steps {
            let name = match step {
                Step::Preprocess => stage::PREPROCESSING,
                Step::Infer => stage::INFERENCE,
                Step::Postprocess => stage::POSTPROCESSING,
                Step::Sample => stage::CAPTURE,
                Step::Act => stage::ACTUATION,
            };
            recorder.record_timer(name, from, to);
        }
        if let Some(error) = send_error {
            return Err(error.into_inference_error(&self.model));
        }
        let failed = |reason| InferenceError::Failed { model: self.model.clone(), reason };
        let parts = call.result.map_err(|error| match error {
            // After the step `infer`, the value that cannot be transferred is the answer and not the sample.
            PythonError::Value(reason) if has_inferred => failed(format!("its answer: {reason}")),
            PythonError::Value(reason) => {
                let (model, sample) = (self.model.clone(), sample.source.clone());
                InferenceError::Input { model, sample, reason }
            }
            error => failed(error.to_string()),
        })?;
        let parts = parts
            .ok_or_else(|| failed("it reported the end of samples, which only a sensor may do".to_owned()))?;
        Ok(Sample { parts, source: String::new(), label: None })
    }
}
