//! The keys of `kind = "onnx"` and the table `[onnxruntime]` of the configuration.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Onnx;
use crate::model::{LoadContext, ModelConfig, ModelKind, ModelTable, SharedKeys};
use crate::{LoadError, Model};

/// Largest number of threads within or across the operators of a model.
const MAX_THREADS: usize = 1024;

/// Keys of a model of `kind = "onnx"`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnnxConfig {
    /// Folder with `model.onnx` and its card `model.toml`.
    pub path: PathBuf,
    /// Threads of each worker within one operator of the model, including the worker's own thread.
    #[serde(default = "one_thread")]
    pub intra_threads: NonZeroUsize,
    /// Threads of each worker across independent operators; above 1 these run in parallel.
    #[serde(default = "one_thread")]
    pub inter_threads: NonZeroUsize,
}

const fn one_thread() -> NonZeroUsize {
    NonZeroUsize::MIN
}

impl ModelKind for OnnxConfig {
    fn unpublished_keys(&self) -> &'static [&'static str] {
        &["path"]
    }

    fn limits(&self) -> Vec<(&'static str, usize, usize)> {
        vec![
            ("intra_threads", self.intra_threads.get(), MAX_THREADS),
            ("inter_threads", self.inter_threads.get(), MAX_THREADS),
        ]
    }

    fn check(&self, shared: &SharedKeys, context: &LoadContext<'_>) -> Result<(), LoadError> {
        Onnx::check(self, shared, context.runtime)
    }

    fn load(&self, shared: &SharedKeys, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
        Ok(Arc::new(Onnx::load(self, shared, context)?))
    }
}

impl ModelConfig {
    /// Returns the configuration of the ONNX model in a folder, with the numbers of threads within an operator and
    /// across operators.
    pub(crate) fn onnx(shared: SharedKeys, path: PathBuf, threads: [NonZeroUsize; 2]) -> Self {
        let [intra_threads, inter_threads] = threads;
        ModelTable { shared, kind_keys: OnnxConfig { path, intra_threads, inter_threads } }.into()
    }
}

/// The table `[onnxruntime]`: the library that runs the models of kind `onnx`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnnxRuntimeConfig {
    /// The library file, or the folder that holds `libonnxruntime.so`. Without this key `ORT_DYLIB_PATH`, the folder
    /// `onnxruntime/lib` and the system's library path are searched, in this order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub library: Option<PathBuf>,
}
