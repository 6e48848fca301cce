//! A worker of an ONNX model.

use std::sync::Arc;

use ort::session::Session;
use peernet_logger::{Recorder, Unit, stage};
use peernet_sample::Sample;

use super::inputs::ModelInputs;
use super::outputs::OutputError;
use super::{Plan, UNKNOWN_LABEL, answer};
use crate::{InferenceError, LoadError, Requester, Worker};

pub(super) struct OnnxWorker {
    plan: Arc<Plan>,
    session: Session,
    inputs: ModelInputs,
}

impl OnnxWorker {
    /// Creates a worker, and runs it once on zeros and the card's constants.
    // The first run of a session is slow. It also shows whether the card fits the model before a sample arrives.
    pub(super) fn new_warmed_up(plan: Arc<Plan>, session: Session) -> Result<Self, LoadError> {
        let mut worker = Self { session, inputs: ModelInputs::new(&plan.card.inputs), plan };
        worker.warm_up().map_err(|error| LoadError::Session {
            file: worker.plan.file.clone(),
            device: worker.plan.device.to_string(),
            reason: error.to_string(),
        })?;
        Ok(worker)
    }

    fn warm_up(&mut self) -> Result<(), OutputError> {
        let outputs = self.session.run(self.inputs.values()?)?;
        answer::check(&self.plan.card, &outputs)
    }
}

impl Worker for OnnxWorker {
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        _requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        let Self { plan, session, inputs } = self;
        let failed = |reason: String| InferenceError::Failed { model: plan.name.to_string(), reason };
        {
            let _stage = recorder.time(stage::PREPROCESSING);
            inputs.fill(sample).map_err(|error| InferenceError::Input {
                model: plan.name.to_string(),
                sample: sample.source.clone(),
                reason: error.to_string(),
            })?;
        }
        let outputs = {
            let _stage = recorder.time(stage::INFERENCE);
            // The outputs are in the host's memory when the session returns: it waits for a GPU and copies its outputs. They stay where
            // the session wrote them until the answer is made. Binding outputs to reused buffers was measured and is not used: 0.73 ms
            // with and without it on the CPU, for an output of 2.8 MB.
            let values = inputs.values().map_err(|error| failed(error.to_string()))?;
            session.run(values).map_err(|error| failed(error.to_string()))?
        };
        let answer = {
            let _stage = recorder.time(stage::POSTPROCESSING);
            answer::answer(&plan.card, &outputs, inputs.transform())
                .map_err(|error| failed(error.to_string()))?
        };
        if sample.label.as_ref().is_some_and(|label| !plan.has_classes_of(label)) {
            recorder.value(UNKNOWN_LABEL, 1.0, Unit::NONE);
        }
        Ok(answer)
    }
}
