//! The table `[bank]` of the configuration.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use super::DEFAULT_MODEL_FOLDER;
use crate::{CommonSettings, ModelConfig};

/// The table `[bank]`: folders of models that are offered in addition to the `[[model]]` tables. A model has the name
/// of its folder and is loaded when it is requested.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BankConfig {
    /// Folders that contain one folder for each model. If several of them contain a model of the same name, the model
    /// in the first folder is used. An empty list offers no models. Default: `["/var/lib/peernet/models"]`, to which
    /// only root can add models.
    pub folders: Vec<PathBuf>,
    /// Devices that may be requested, named like a model's `device`; the first device is used for requests without a
    /// device. Default: `["cpu"]`.
    pub devices: Vec<String>,
    /// Maximum number of models of these folders that may be loaded at the same time, 1 to 64. When a further model is
    /// requested, the model whose last request is the oldest is unloaded if it is not in use. Default: 2.
    #[serde(rename = "most_loaded")]
    pub max_loaded: NonZeroUsize,
    /// Number of worker threads of each model; each thread computes one sample at a time. Default: 1.
    pub workers: NonZeroUsize,
    /// Maximum number of samples that wait for a free worker; further samples are rejected. Default: 16.
    pub queue: NonZeroUsize,
    /// Number of threads with which a worker computes one operator of the model, including the worker's own thread.
    /// Default: 1.
    pub intra_threads: NonZeroUsize,
    /// Number of threads with which a worker computes independent operators in parallel; with 1, one operator runs
    /// after the other. Default: 1.
    pub inter_threads: NonZeroUsize,
}

impl Default for BankConfig {
    fn default() -> Self {
        let one = NonZeroUsize::MIN;
        Self {
            folders: vec![DEFAULT_MODEL_FOLDER.into()],
            devices: vec!["cpu".to_owned()],
            max_loaded: one.saturating_add(1),
            workers: one,
            queue: one.saturating_add(15),
            intra_threads: one,
            inter_threads: one,
        }
    }
}

impl BankConfig {
    /// Largest permitted value of `most_loaded`.
    pub(super) const MAX_LOADED: usize = 64;

    /// Returns the configuration of a model in the folders: equal to that of a `[[model]]` table with the values of
    /// this table.
    pub fn model(&self, name: &Slug, folder: &Path, device: &str) -> ModelConfig {
        let (workers, queue) = (self.workers, self.queue);
        let common = CommonSettings { name: name.clone(), device: device.to_owned(), workers, queue };
        ModelConfig::onnx(common, folder.to_owned(), [self.intra_threads, self.inter_threads])
    }
}
