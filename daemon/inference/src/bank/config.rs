//! `[bank]` in the configuration.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use super::INSTALLED;
use crate::{ModelConfig, SharedKeys};

/// `[bank]`: folders of models that are offered beside the `[[model]]`s, each by the name of its folder, loaded when
/// somebody asks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BankConfig {
    /// Folders that hold one folder per model; the first that has a model of the wanted name is taken. An empty list
    /// offers none. Default: `["/var/lib/peernet/models"]`, where only root can put one.
    pub folders: Vec<PathBuf>,
    /// The devices that may be asked for, of the same names as a model's `device`; the first is for those who name
    /// none. Default: `["cpu"]`.
    pub devices: Vec<String>,
    /// Models of these folders that may be in memory at once, at most 64. When one more is asked for, the one that was
    /// asked for longest ago is unloaded, if nobody uses it. Default: 2.
    pub most_loaded: NonZeroUsize,
    /// Threads that compute, each on a sample of its own. Default: 1.
    pub workers: NonZeroUsize,
    /// Samples that may wait for a free worker; more are refused. Default: 16.
    pub queue: NonZeroUsize,
    /// Threads of each worker within one operator of the model; the worker's own thread counts. Default: 1.
    pub intra_threads: NonZeroUsize,
    /// Threads of each worker across independent operators; above 1 they run in parallel. Default: 1.
    pub inter_threads: NonZeroUsize,
}

impl Default for BankConfig {
    fn default() -> Self {
        let one = NonZeroUsize::MIN;
        Self {
            folders: vec![INSTALLED.into()],
            devices: vec!["cpu".to_owned()],
            most_loaded: one.saturating_add(1),
            workers: one,
            queue: one.saturating_add(15),
            intra_threads: one,
            inter_threads: one,
        }
    }
}

impl BankConfig {
    /// Most models of the folders in memory at once.
    pub(super) const MOST_LOADED: usize = 64;

    /// A model of the folders, as a `[[model]]` would have it.
    pub fn model(&self, name: &Slug, folder: &Path, device: &str) -> ModelConfig {
        let (workers, queue) = (self.workers, self.queue);
        let shared = SharedKeys { name: name.clone(), device: device.to_owned(), workers, queue };
        ModelConfig::onnx(shared, folder.to_owned(), [self.intra_threads, self.inter_threads])
    }
}
