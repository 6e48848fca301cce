//! A worker of an ONNX model.

use std::sync::Arc;

use bytes::Bytes;
use ort::session::Session;
use ort::value::TensorRef;
use peernet_logger::{Recorder, Unit, stage};
use peernet_sample::{Description, MediaType, Sample, normalized_label};

use super::card::Card;
use super::classify::classify;
use super::preprocess::Preprocessor;
use super::{Plan, UNKNOWN_LABEL};
use crate::{InferenceError, LoadError, Requester, Worker};

/// Reason that a run of the session gave no output that fits the card.
#[derive(Debug, thiserror::Error)]
enum RunError {
    /// Error of ONNX Runtime.
    #[error(transparent)]
    Runtime(#[from] ort::Error),
    /// The number of outputs differs from the number of labels.
    #[error("it gave {actual} numbers for {expected} labels")]
    Length { actual: usize, expected: usize },
}

pub(super) struct OnnxWorker {
    plan: Arc<Plan>,
    session: Session,
    preprocessor: Preprocessor,
    /// The model's output, copied out of the session.
    numbers: Vec<f32>,
}

impl OnnxWorker {
    /// Creates a worker, and runs it once on zeros.
    // The first run of a session is slow. It also shows whether the card fits the model before a sample arrives.
    pub(super) fn new_warmed_up(plan: Arc<Plan>, session: Session) -> Result<Self, LoadError> {
        let preprocessor = Preprocessor::new(&plan.card);
        let mut worker = Self { session, preprocessor, numbers: Vec::new(), plan };
        worker.run().map_err(|error| LoadError::Session {
            file: worker.plan.file.clone(),
            device: worker.plan.device.to_string(),
            reason: error.to_string(),
        })?;
        Ok(worker)
    }

    /// Runs the model on the preprocessor's tensor; the result is in `numbers`.
    fn run(&mut self) -> Result<(), RunError> {
        let Self { plan, session, preprocessor, numbers } = self;
        compute(&plan.card, session, preprocessor.tensor(), numbers)?;
        let (actual, expected) = (numbers.len(), plan.card.output.labels.len());
        if actual != expected {
            return Err(RunError::Length { actual, expected });
        }
        Ok(())
    }
}

/// Runs the model. The output is in the host's memory when the session returns: `run` waits for a GPU and copies its
/// output.
fn compute(card: &Card, session: &mut Session, tensor: &[f32], numbers: &mut Vec<f32>) -> ort::Result<()> {
    let tensor = TensorRef::from_array_view((card.input.shape, tensor))?;
    let outputs = session.run(ort::inputs![tensor])?;
    let name = &card.output.name;
    let output = outputs.get(name).ok_or_else(|| ort::Error::new(format!("there is no output {name:?}")))?;
    let (_, values) = output.try_extract_tensor::<f32>()?;
    numbers.clear();
    numbers.extend_from_slice(values);
    Ok(())
}

impl Worker for OnnxWorker {
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        _requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        {
            let _stage = recorder.time(stage::PREPROCESSING);
            self.preprocessor.preprocess(sample).map_err(|error| InferenceError::Input {
                model: self.plan.name.to_string(),
                sample: sample.source.clone(),
                reason: error.to_string(),
            })?;
        }
        let failed = |plan: &Plan, reason| InferenceError::Failed { model: plan.name.to_string(), reason };
        {
            let _stage = recorder.time(stage::INFERENCE);
            self.run().map_err(|error| failed(&self.plan, error.to_string()))?;
        }
        let json = {
            let _stage = recorder.time(stage::POSTPROCESSING);
            classify(&self.plan.card.output, &mut self.numbers)
                .map_err(|error| failed(&self.plan, error.to_string()))?
        };
        if sample.label.as_ref().is_some_and(|label| !self.plan.classes.contains(&normalized_label(label))) {
            recorder.value(UNKNOWN_LABEL, 1.0, Unit::NONE);
        }
        Ok(Sample::from_part(Description::unshaped(MediaType::Json), Bytes::from(json)))
    }
}
