//! `kind = "python"`.

use std::collections::BTreeMap;
use std::num::{NonZeroU64, NonZeroUsize};
use std::path::PathBuf;

use peernet_external::python::{Images, PythonConfig};
use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use crate::defaults::{cpu, one, sixteen};

/// `kind = "python"`: a Python object of the user's own, each worker in a process of its own.
///
/// The keys beside `name`, `device`, `workers` and `queue` are those of a Python sensor ([`PythonConfig`]). They stand here
/// once more because serde, flattening one table into another, no longer tells which keys there are when one is misspelt.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PythonModelConfig {
    /// The name under which peers ask for it.
    pub name: Slug,
    /// `module::object` with `infer(x)`, and with `preprocess(x)` and `postprocess(y)` where it has them.
    pub object: String,
    /// What peers are told that it runs on; the object finds it in the variable `PEERNET_DEVICE`. Default: `cpu`.
    #[serde(default = "cpu")]
    pub device: String,
    /// Processes, each computing on a sample of its own. Default: 1.
    #[serde(default = "one")]
    pub workers: NonZeroUsize,
    /// Samples that may wait for a free worker; more are refused. Default: 16.
    #[serde(default = "sixteen")]
    pub queue: NonZeroUsize,
    /// Where the module is looked for first. Default: the current directory.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// The Python to run. Default: `PEERNET_PYTHON`, else `python3`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub python: Option<PathBuf>,
    /// Environment variables for it.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub env: BTreeMap<String, String>,
    /// Pickle answers that have no form of their own, and unpickle samples: only for peers that are trusted. Default: no.
    #[serde(default)]
    pub pickle: bool,
    /// What the object is given for a picture. Default: `pil`.
    #[serde(default)]
    pub images: Images,
    /// How long one sample may take; milliseconds, up to a day. Default: 60000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timeout_ms: Option<NonZeroU64>,
    /// How long importing the module and making the object may take; milliseconds, up to a day. Default: 300000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_timeout_ms: Option<NonZeroU64>,
}

impl PythonModelConfig {
    /// What is asked of the process.
    pub(super) fn process(&self) -> PythonConfig {
        let default = PythonConfig::of(&self.object);
        PythonConfig {
            folder: self.folder.clone(),
            python: self.python.clone(),
            env: self.env.clone(),
            pickle: self.pickle,
            images: self.images,
            timeout_ms: self.timeout_ms.unwrap_or(default.timeout_ms),
            start_timeout_ms: self.start_timeout_ms.unwrap_or(default.start_timeout_ms),
            ..default
        }
    }
}
