//! `kind = "exec"`.

use std::collections::BTreeMap;
use std::num::{NonZeroU64, NonZeroUsize};
use std::path::PathBuf;

use peernet_external::exec::{CommandLine, ExecConfig};
use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use crate::defaults::{cpu, one, sixteen};

/// `kind = "exec"`: a program of the user's own, one process for each worker.
///
/// The keys beside `name`, `device`, `workers` and `queue` are those of an exec sensor ([`ExecConfig`]). They stand here
/// once more because serde, flattening one table into another, no longer tells which keys there are when one is misspelt.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExecModelConfig {
    /// The name under which peers ask for it.
    pub name: Slug,
    /// The program: `["./blur", "--fast"]`, or a line for `sh -c`.
    pub command: CommandLine,
    /// What peers are told that it runs on; the program finds it in the variable `PEERNET_DEVICE`. Default: `cpu`.
    #[serde(default = "cpu")]
    pub device: String,
    /// Processes, each computing on a sample of its own. Default: 1.
    #[serde(default = "one")]
    pub workers: NonZeroUsize,
    /// Samples that may wait for a free worker; more are refused. Default: 16.
    #[serde(default = "sixteen")]
    pub queue: NonZeroUsize,
    /// How long it may take for one answer; milliseconds, up to a day. Default: 10000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timeout_ms: Option<NonZeroU64>,
    /// The folder it runs in. Default: the current directory.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// Environment variables for it.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub env: BTreeMap<String, String>,
}

impl ExecModelConfig {
    /// What is asked of the process.
    pub(crate) fn process(&self) -> ExecConfig {
        let default = ExecConfig::of(self.command.clone());
        let mut env = self.env.clone();
        env.insert("PEERNET_DEVICE".to_owned(), self.device.clone());
        let timeout_ms = self.timeout_ms.unwrap_or(default.timeout_ms);
        ExecConfig { timeout_ms, folder: self.folder.clone(), env, ..default }
    }
}
