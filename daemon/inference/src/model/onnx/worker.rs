//! A worker of an ONNX model.

use std::sync::Arc;

use ort::session::Session;
use peernet_clock::{SharedClock, Span};
use peernet_logger::{Name, Recorder, TimerGuard, Unit, stage};
use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

use super::card::Input;
use super::inputs::ModelInputs;
use super::library::LibraryUse;
use super::outputs::{OutputError, Outputs, Row};
use super::picture::InputError;
use super::termination::TerminableRun;
use super::{ModelSettings, answer, card_match};
use crate::{InferenceError, LoadError, Request, Requester, Worker};

/// Node below `inference`: the number of samples that the session computed in one run. Recorded for models that compute
/// batches.
const BATCH_SIZE: Name = Name::from_static("batch-size");

pub(super) struct OnnxWorker {
    settings: Arc<ModelSettings>,
    session: Session,
    inputs: ModelInputs,
    /// Cancelled when the bank of models shuts down.
    stop: CancellationToken,
    clock: SharedClock,
    /// Duration of the longest run that succeeded, including the runs that warmed the session up.
    longest_run: Span,
    /// This is the last field: fields are dropped in the order of their declaration, and the use of the library must
    /// end after the session is released.
    _library_use: LibraryUse,
}

impl OnnxWorker {
    /// Creates a worker and warms it up: runs the session on zeros and the card's constants, for one sample and for the
    /// largest batch. These two sizes need different amounts of memory.
    // The first inference of a session is slow. It also shows, before a sample arrives, whether the card fits the
    // model.
    pub(super) fn new_warmed_up(
        settings: Arc<ModelSettings>,
        session: Session,
        library_use: LibraryUse,
        stop: CancellationToken,
        clock: SharedClock,
    ) -> Result<Self, LoadError> {
        let max_size = settings.batching.max_size;
        let is_batched = |input: &Input| max_size > 1 && card_match::has_open_batch(input, session.inputs());
        let inputs = ModelInputs::new(&settings.card.inputs, max_size, is_batched);
        let longest_run = Span::ZERO;
        let mut worker =
            Self { session, inputs, settings, stop, clock, longest_run, _library_use: library_use };
        let sizes = if max_size > 1 { &[1, max_size][..] } else { &[1] };
        sizes.iter().try_for_each(|size| worker.warm_up(*size)).map_err(|error| LoadError::Session {
            file: worker.settings.file.clone(),
            device: worker.settings.device.to_string(),
            reason: error.to_string(),
        })?;
        Ok(worker)
    }

    /// Runs the session on a batch of zeros and checks the outputs.
    fn warm_up(&mut self, batch: usize) -> Result<(), OutputError> {
        let started_at = self.clock.mono();
        // Without requests, only `stop` terminates the run, so `overdue_at` has no effect.
        let overdue_at = started_at;
        let run = TerminableRun::new(Vec::new(), &self.stop, &self.clock, overdue_at)?;
        let outputs = self.session.run_with_options(self.inputs.values(batch)?, run.options())?;
        self.longest_run = self.longest_run.max(self.clock.mono() - started_at);
        // Any row of the batch would do: only types and shapes are checked.
        answer::check(&self.settings.card, &Outputs::new(&outputs, Row { index: batch - 1, batch }))
    }

    /// Returns the error of a request for which there is no result.
    fn no_answer(&self) -> InferenceError {
        InferenceError::Failed {
            model: self.settings.name.to_string(),
            reason: "it gave no answer".to_owned(),
        }
    }

    /// Fills the inputs. Returns for each sample whether it can be computed. The samples that can be computed fill the
    /// first rows, in their order.
    fn preprocess(&mut self, samples: &[&Sample]) -> Vec<Result<(), InferenceError>> {
        let convert_error = |(result, sample): (Result<(), InputError>, &&Sample)| {
            result.map_err(|error| InferenceError::Input {
                model: self.settings.name.to_string(),
                sample: sample.source.clone(),
                reason: error.to_string(),
            })
        };
        self.inputs.fill(samples).into_iter().zip(samples).map(convert_error).collect()
    }

    /// Computes the answers to the samples in the first rows, as many rows as there are recorders. The `cancellations`
    /// may terminate the run. The outer error is an error of the whole run.
    fn compute(
        &mut self,
        recorders: &mut [&mut Recorder],
        cancellations: Vec<CancellationToken>,
    ) -> Result<Vec<Result<Sample, InferenceError>>, InferenceError> {
        let Self { settings, session, inputs, stop, clock, longest_run, .. } = self;
        let failed = |reason: String| InferenceError::Failed { model: settings.name.to_string(), reason };
        let batch = recorders.len();
        let started_at = clock.mono();
        // Twice the longest run, because this run may share the processor with other programs.
        let overdue_at = started_at + *longest_run + *longest_run;
        let run = TerminableRun::new(cancellations, stop, clock, overdue_at)
            .map_err(|error| failed(error.to_string()))?;
        let outputs = {
            let mut stages = time_all(recorders, &stage::INFERENCE);
            // The outputs are in the host's memory when the session returns: the session waits for a GPU and copies the
            // GPU's outputs. The outputs are not bound to reused buffers, because that saves no time: 0.73 ms with and
            // without bound buffers on the CPU, for an output of 2.8 MB.
            let values = inputs.values(batch).map_err(|error| failed(error.to_string()))?;
            let outputs = session.run_with_options(values, run.options()).map_err(|error| {
                let model = settings.name.to_string();
                if stop.is_cancelled() {
                    InferenceError::Stopped { model }
                } else if run.is_unneeded() {
                    InferenceError::Cancelled { model }
                } else {
                    failed(error.to_string())
                }
            });
            // The requests of a run that failed are computed again, each alone. The later runs record the batch size.
            let will_be_repeated = batch > 1 && matches!(outputs, Err(InferenceError::Failed { .. }));
            if settings.batching.is_on() && !will_be_repeated {
                for recorder in &mut stages {
                    recorder.record_value(BATCH_SIZE, batch as f64, Unit::NONE);
                }
            }
            outputs?
        };
        *longest_run = (*longest_run).max(clock.mono() - started_at);
        let _stages = time_all(recorders, &stage::POSTPROCESSING);
        let answer = |index: usize| {
            let outputs = Outputs::new(&outputs, Row { index, batch });
            answer::answer(&settings.card, &outputs, inputs.transform(index))
                .map_err(|error| failed(error.to_string()))
        };
        Ok((0..batch).map(answer).collect())
    }

    /// Computes the answers of several requests in one run. If the library refuses the run, or if a request is
    /// cancelled while the run is overdue, each request is computed alone: the sample of one request may be the reason.
    fn compute_together(&mut self, requests: &mut [Request<'_>]) -> Vec<Result<Sample, InferenceError>> {
        let samples: Vec<&Sample> = requests.iter().map(|request| request.sample).collect();
        let tokens: Vec<_> = requests.iter().map(|request| request.requester.cancellation()).collect();
        let mut recorders: Vec<&mut Recorder> =
            requests.iter_mut().map(|request| &mut *request.recorder).collect();
        let preprocessed = {
            let _stages = time_all(&mut recorders, &stage::PREPROCESSING);
            self.preprocess(&samples)
        };
        let mut ready_recorders: Vec<&mut Recorder> = recorders
            .into_iter()
            .zip(&preprocessed)
            .filter_map(|(recorder, result)| result.is_ok().then_some(recorder))
            .collect();
        let cancellations = tokens
            .into_iter()
            .zip(&preprocessed)
            .filter_map(|(token, result)| result.is_ok().then_some(token))
            .collect();
        let count = ready_recorders.len();
        let computed =
            if count == 0 { Ok(Vec::new()) } else { self.compute(&mut ready_recorders, cancellations) };
        let mut answers = match computed {
            Err(InferenceError::Failed { .. }) if count > 1 => return self.compute_one_by_one(requests),
            Err(error) => vec![Err(error); count].into_iter(),
            Ok(answers) => answers.into_iter(),
        };
        preprocessed
            .into_iter()
            .map(|result| result.and_then(|()| answers.next().unwrap_or_else(|| Err(self.no_answer()))))
            .collect()
    }

    /// Computes each request alone after the run with all requests has failed. While other requests are computed, a
    /// request is in the stage `batch-wait`.
    fn compute_one_by_one(&mut self, requests: &mut [Request<'_>]) -> Vec<Result<Sample, InferenceError>> {
        let started_at = self.clock.mono();
        let mut results = Vec::with_capacity(requests.len());
        let mut computed_at = Vec::with_capacity(requests.len());
        for request in requests.iter_mut() {
            request.recorder.record_timer(stage::BATCH_WAIT, started_at, self.clock.mono());
            if request.requester.cancellation().is_cancelled() {
                results.push(Err(InferenceError::Cancelled { model: self.settings.name.to_string() }));
            } else {
                results.extend(self.compute_together(std::slice::from_mut(request)));
            }
            computed_at.push(self.clock.mono());
        }
        let ended_at = self.clock.mono();
        for (request, computed_at) in requests.iter_mut().zip(computed_at) {
            request.recorder.record_timer(stage::BATCH_WAIT, computed_at, ended_at);
        }
        results
    }
}

/// Starts a stage in all recorders.
fn time_all<'a>(recorders: &'a mut [&mut Recorder], stage: &Name) -> Vec<TimerGuard<'a>> {
    recorders.iter_mut().map(|recorder| recorder.time(stage.clone())).collect()
}

impl Worker for OnnxWorker {
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        let results = self.infer_batch(&mut [Request { sample, recorder, requester }]);
        results.into_iter().next().unwrap_or_else(|| Err(self.no_answer()))
    }

    fn infer_batch(&mut self, requests: &mut [Request<'_>]) -> Vec<Result<Sample, InferenceError>> {
        let results = self.compute_together(requests);
        // All stages have ended, so that the value is recorded directly below the root, where the edge looks for it.
        for (request, _) in requests.iter_mut().zip(&results).filter(|(_, result)| result.is_ok()) {
            let label = request.sample.label.as_ref();
            if label.is_some_and(|label| !self.settings.has_classes_of(label)) {
                request.recorder.record_value(stage::UNKNOWN_LABEL, 1.0, Unit::NONE);
            }
        }
        results
    }
}
