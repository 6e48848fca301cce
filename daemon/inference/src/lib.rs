//! Models of the kinds that [`model::ModelConfig`] lists. A model is loaded once. Its own threads take samples from a
//! bounded queue; a model that does not block computes on the thread of its caller instead.
//!
//! [`Bank`] holds the models that a host offers. It loads a requested model once and returns its [`Pool`];
//! [`Pool::submit`] accepts jobs, and each job's `reply` receives the result.
//!
//! A new kind of model is one file or folder in [`model`], registered in `model/mod.rs`.

pub mod bank;
mod batching;
mod blockage_detector;
mod error;
mod job;
mod loaded_models;
mod locked_temp_dir;
pub mod model;
mod pool;
mod process_memory;
mod queue;
mod requester;
mod temp_dirs;
mod thread;

pub use bank::{Bank, BankConfig, UnloadReason, UnloadedModel};
pub use batching::{Batching, Request};
pub use error::{InferenceError, LibraryError, LoadError};
pub use job::{FinishedJob, Job, RefusedJob, Reply};
pub use loaded_models::LoadedModels;
pub use locked_temp_dir::LockedTempDir;
pub use model::onnx::{CardSummary, MODEL_HASH, OnnxRuntimeConfig, check_library, is_library_in_use};
pub use model::{CommonSettings, ModelConfig};
pub use pool::Pool;
pub use process_memory::ProcessMemory;
pub use requester::{Cancelled, PartialAnswerError, Requester, UncancelledRequester};

use peernet_logger::Recorder;
use peernet_sample::Sample;

/// Computes answers with a loaded model; used by one thread at a time.
pub trait Worker: Send {
    /// Computes the answer to a sample, and records those of the stages `preprocessing`, `inference` and
    /// `postprocessing` that the model has. May send partial answers to `requester`. If the request is cancelled, stops
    /// early where the model can be interrupted.
    ///
    /// # Errors
    /// If the model cannot answer this sample. The next sample may succeed.
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        requester: &dyn Requester,
    ) -> Result<Sample, InferenceError>;

    /// Computes the answers of several requests together, at most as many as [`Model::batching`] allows. Returns one
    /// result per request, in their order. For each request, a stage is recorded with the start and the end that the
    /// stage has for the whole batch.
    ///
    /// The default implementation, for models without batches, calls [`infer`](Self::infer) for one request after the
    /// other.
    fn infer_batch(&mut self, requests: &mut [Request<'_>]) -> Vec<Result<Sample, InferenceError>> {
        requests
            .iter_mut()
            .map(|request| self.infer(request.sample, request.recorder, request.requester))
            .collect()
    }
}

/// A loaded model.
pub trait Model: Send + Sync {
    /// Creates a worker for one more thread; all workers share the loaded model.
    ///
    /// # Errors
    /// If the device has no memory for another worker.
    fn create_worker(&self) -> Result<Box<dyn Worker>, LoadError>;

    /// Returns whether `infer` may block or compute for long. Such a model must not run on an I/O thread.
    fn blocks(&self) -> bool {
        true
    }

    /// Returns the limits of the batches that a worker computes.
    fn batching(&self) -> Batching {
        Batching::OFF
    }

    /// Returns the device on which the model runs, such as `cpu` or `cuda:0`.
    fn device(&self) -> String;

    /// Returns facts for the run's page: pairs such as (`Model`, `quality-control 1`).
    fn facts(&self) -> Vec<(String, String)>;
}
