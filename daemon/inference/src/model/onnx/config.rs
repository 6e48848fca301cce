//! The keys of `kind = "onnx"` and the table `[onnxruntime]` of the configuration.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::SharedClock;
use serde::{Deserialize, Serialize};

use super::Onnx;
use super::library::Runtime;
use crate::model::{CommonSettings, LoadContext, ModelConfig, ModelKind, ModelTable};
use crate::{Batching, LibraryError, LoadError, Model};

/// Maximum number of threads within or across the operators of a model.
const MAX_THREADS: usize = 1024;
/// Maximum number of requests in a batch.
const MAX_BATCH: usize = 1024;
/// Largest permitted value of `max_wait_ms`.
const MAX_BATCH_WAIT_MS: f64 = 60_000.0;

/// Keys of a model of `kind = "onnx"`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnnxConfig {
    /// Folder with `model.onnx` and its card `model.toml`.
    pub path: PathBuf,
    /// Number of threads with which a worker computes one operator of the model, including the worker's own thread.
    #[serde(default = "one_thread")]
    pub intra_threads: NonZeroUsize,
    /// Number of threads with which a worker computes independent operators in parallel; with 1, one operator runs
    /// after the other.
    #[serde(default = "one_thread")]
    pub inter_threads: NonZeroUsize,
    /// Limits of the batches in which a worker computes concurrent requests. Without this key, each request is computed
    /// alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub batch: Option<BatchConfig>,
}

/// The key `batch`: limits of the requests that are computed in one run of the session.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatchConfig {
    /// Maximum number of requests in a batch.
    pub max_size: NonZeroUsize,
    /// Longest time for which the first request of a batch waits for further requests, milliseconds. With 0, a batch
    /// has only requests that already wait in the queue.
    #[serde(default)]
    pub max_wait_ms: f64,
}

impl OnnxConfig {
    /// Returns the limits of a batch.
    pub(super) fn batching(&self) -> Batching {
        self.batch.map_or(Batching::OFF, |BatchConfig { max_size, max_wait_ms }| Batching {
            max_size: max_size.get(),
            max_wait: Duration::from_secs_f64(max_wait_ms * 1e-3),
        })
    }

    fn check_batch(&self, common: &CommonSettings) -> Result<(), LoadError> {
        let wait_ms = self.batch.map_or(0.0, |batch| batch.max_wait_ms);
        if (0.0..=MAX_BATCH_WAIT_MS).contains(&wait_ms) {
            return Ok(());
        }
        Err(LoadError::InvalidKey {
            model: common.name.to_string(),
            key: "batch.max_wait_ms",
            reason: format!("{wait_ms} is not a time; write milliseconds, from 0 to {MAX_BATCH_WAIT_MS}"),
        })
    }
}

const fn one_thread() -> NonZeroUsize {
    NonZeroUsize::MIN
}

impl ModelKind for OnnxConfig {
    fn keys_omitted_from_runs(&self) -> &'static [&'static str] {
        &["path"]
    }

    fn limits(&self) -> Vec<(&'static str, usize, usize)> {
        let batch = self.batch.map_or(1, |batch| batch.max_size.get());
        vec![
            ("batch.max_size", batch, MAX_BATCH),
            ("intra_threads", self.intra_threads.get(), MAX_THREADS),
            ("inter_threads", self.inter_threads.get(), MAX_THREADS),
        ]
    }

    fn check(&self, common: &CommonSettings, context: &LoadContext<'_>) -> Result<(), LoadError> {
        self.check_batch(common)?;
        Onnx::check(self, common, context)
    }

    fn load(&self, common: &CommonSettings, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
        self.check_batch(common)?;
        Ok(Arc::new(Onnx::load(self, common, context)?))
    }
}

impl ModelConfig {
    /// Returns the configuration of the ONNX model in a folder, with the numbers of threads within an operator and
    /// across operators.
    pub(crate) fn onnx(common: CommonSettings, path: PathBuf, threads: [NonZeroUsize; 2]) -> Self {
        let [intra_threads, inter_threads] = threads;
        ModelTable { common, kind_settings: OnnxConfig { path, intra_threads, inter_threads, batch: None } }
            .into()
    }
}

/// Loads ONNX Runtime, as the first model of kind `onnx` would do. A process loads the library only once.
///
/// # Errors
/// If the library cannot be found or used.
pub fn check_library(config: &OnnxRuntimeConfig, clock: &SharedClock) -> Result<(), LibraryError> {
    Runtime::get(config, clock).map(drop)
}

/// The table `[onnxruntime]`: the library that runs the models of kind `onnx`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnnxRuntimeConfig {
    /// The library file, or the folder that holds `libonnxruntime.so`. Without this key, the library is the one that
    /// `ORT_DYLIB_PATH` names. If this variable is not set, these places are searched in this order: the folder
    /// `onnxruntime/lib` below the current folder, below the program's folder and below each folder above that folder;
    /// `/usr/lib/peernet`; the system's library path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub library: Option<PathBuf>,
}
