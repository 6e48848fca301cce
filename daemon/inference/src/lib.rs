//! Models ([`model::ModelConfig`] lists the kinds): loaded once, run by their own threads behind a bounded queue.
//!
//! [`Bank`] is the list of models that a host offers and the only way to one. Asked for a model it loads it,
//! once, and hands out its [`Pool`]: jobs go in by [`Pool::submit`], each comes back through its own `reply`.
//!
//! A new kind is one file or folder in [`model`], registered in the `mod.rs` there.

pub mod bank;
mod error;
mod job;
mod litter;
pub mod model;
mod pool;
mod queue;
mod scratch;
mod thread;

pub use bank::{Bank, BankConfig};
pub use error::{InferenceError, LibraryError, LoadError};
pub use job::{Done, Job, Refused};
pub use model::onnx::{CardSummary, MODEL_HASH, OnnxRuntimeConfig, UNKNOWN_LABEL};
pub use model::{ModelConfig, SharedKeys};
pub use pool::Pool;
pub use scratch::Scratch;

use peernet_logger::Recorder;
use peernet_sample::Sample;

/// One thread's use of a loaded model.
pub trait Worker: Send {
    /// Computes the answer, recording `preprocessing`, `inference` and `postprocessing` as it goes
    /// (only the stages it really has).
    ///
    /// # Errors
    /// When this sample cannot be computed on; the next may well be.
    fn infer(&mut self, sample: &Sample, log: &mut Recorder) -> Result<Sample, InferenceError>;
}

/// A model that was loaded and can be run.
pub trait Model: Send + Sync {
    /// A worker of its own for one more thread; all share the loaded model.
    ///
    /// # Errors
    /// When the device has no room for another.
    fn worker(&self) -> Result<Box<dyn Worker>, LoadError>;

    /// Whether `infer` may block or compute for long, and so must not run on an I/O thread.
    fn blocks(&self) -> bool {
        true
    }

    /// The device it really runs on, such as `cpu` or `cuda:0`.
    fn device(&self) -> String;

    /// What it is, in words, for the run's page: pairs such as (`Model`, `quality-control 1`).
    fn facts(&self) -> Vec<(String, String)>;
}
