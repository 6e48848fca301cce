//! Models: `onnx`, `echo`, `sleep`; loaded once, run by their own threads behind a bounded queue.
//!
//! A new kind is one file or folder here plus one line in [`ModelConfig`].

use std::sync::Arc;

use peernet_clock::MonoTime;
use peernet_logger::{Recorder, Slug};
use peernet_sample::Sample;
use serde::{Deserialize, Serialize};

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
    /// A worker of its own for one more thread; all share the loaded weights.
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

    /// What it is, in words, for the run's page.
    fn facts(&self) -> Vec<(String, String)>;
}
