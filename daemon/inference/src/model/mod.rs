//! Kinds of models: one file or folder for each, and their registration in [`ModelConfig`].

pub mod distribution;
pub mod echo;
pub mod exec;
pub mod onnx;
pub mod openai;
pub mod python;
mod settings;
pub mod sleep;
mod table;

pub use table::{CommonSettings, Keys, ModelTable};

use std::collections::BTreeMap;
use std::sync::Arc;

use enum_dispatch::enum_dispatch;
use peernet_clock::SharedClock;
use peernet_external::exec::FingerprintKey;
use peernet_external::hide_values;
use peernet_logger::Slug;
use serde::{Deserialize, Serialize};
use tokio_util::sync::CancellationToken;

use crate::temp_dirs::TempDirs;
use crate::{LoadError, Model};
use onnx::OnnxRuntimeConfig;

/// Maximum number of worker threads of one model.
const MAX_WORKERS: usize = 256;
/// Maximum number of samples that wait for one model.
const MAX_QUEUE: usize = 65_536;

/// Kind of model. The type that implements this trait has the settings that only this kind has; [`CommonSettings`] has
/// those of several kinds.
pub trait ModelKind {
    /// Returns the keys of the common settings that a model of this kind has; `name` is one of them. Default: all.
    ///
    /// A kind whose [`Model::blocks`] returns `false` has neither `workers` nor `queue`, because it runs on the
    /// thread of its caller.
    fn common_keys() -> &'static [&'static str]
    where
        Self: Sized,
    {
        CommonSettings::keys()
    }

    /// Returns the device of a model whose table does not name one.
    fn default_device() -> &'static str
    where
        Self: Sized,
    {
        CommonSettings::DEFAULT_DEVICE
    }

    /// Returns the keys that the description of a run omits. Their values are recorded elsewhere in the description, or
    /// show where files are on this host.
    fn keys_omitted_from_runs(&self) -> &'static [&'static str] {
        &[]
    }

    /// Returns the numbers among the kind's own keys: key, value and upper limit.
    fn limits(&self) -> Vec<(&'static str, usize, usize)> {
        Vec::new()
    }

    /// Returns whether this kind runs a custom program. The program's arguments are published only as a fingerprint.
    fn is_program(&self) -> bool {
        false
    }

    /// Returns the fact that distinguishes programs with different arguments; the arguments themselves may be secret.
    fn arguments_fact(&self, _key: &FingerprintKey) -> Option<(String, String)> {
        None
    }

    /// Returns the environment variables that the configuration sets for the processes of custom code; `None` if the
    /// kind has none.
    fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        None
    }

    /// Returns the setting of the seed of the model's random numbers, which may be missing; `None` if the kind uses no
    /// random numbers.
    fn seed_mut(&mut self) -> Option<&mut Option<u64>> {
        None
    }

    /// Removes those keys from `keys` that need not be recorded, because they have their defaults or no effect.
    // The settings of two runs are compared as texts. A default that earlier versions did not record would appear as a
    // difference.
    fn remove_defaults(&self, _keys: &mut Keys) {}

    /// Checks the configuration without loading the model or running custom code.
    ///
    /// # Errors
    /// If the configuration contradicts itself, or if something that it names does not exist.
    fn check(&self, _common: &CommonSettings, _context: &LoadContext<'_>) -> Result<(), LoadError> {
        Ok(())
    }

    /// Loads the part of the model that all workers share. Blocks.
    ///
    /// # Errors
    /// If the model cannot be loaded.
    fn load(&self, common: &CommonSettings, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError>;
}

/// Objects of the bank that loading a model may need.
#[derive(Debug)]
pub struct LoadContext<'a> {
    /// The table `[onnxruntime]`.
    pub(crate) runtime: &'a OnnxRuntimeConfig,
    /// The bank's set of temporary folders, to which a model adds its own.
    pub(crate) temp_dirs: &'a TempDirs,
    /// Clock for deadlines.
    pub(crate) clock: &'a SharedClock,
    /// All configured models. A model may use another one as its inner model.
    pub(crate) models: Vec<&'a ModelConfig>,
    /// Cancelled when the bank of models shuts down.
    pub(crate) stop: &'a CancellationToken,
}

/// A table `[[model]]`: one model that this host offers. New kinds are registered here.
#[enum_dispatch(Table)]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum ModelConfig {
    /// A model in ONNX form, run by ONNX Runtime.
    Onnx(ModelTable<onnx::OnnxConfig>),
    /// A custom Python object with `infer(x)`.
    Python(ModelTable<python::PythonConfig>),
    /// A custom program; see docs/external-programs.md.
    Exec(ModelTable<exec::ExecConfig>),
    /// A model that answers with its input at once, to measure the time around a model.
    Echo(ModelTable<echo::EchoConfig>),
    /// A model of known latency: each stage waits for the configured time.
    Sleep(ModelTable<sleep::SleepConfig>),
    /// A language model behind a server with the chat API of OpenAI.
    Openai(ModelTable<openai::OpenaiConfig>),
    /// A model whose latencies are drawn from a distribution, in place of a machine that is not available.
    Distribution(ModelTable<distribution::DistributionConfig>),
}

/// Access to a model's table, independent of its kind.
#[enum_dispatch]
pub(crate) trait Table {
    fn common(&self) -> &CommonSettings;
    fn kind_settings(&self) -> &dyn ModelKind;
    fn kind_settings_mut(&mut self) -> &mut dyn ModelKind;
}

impl<K: ModelKind + 'static> Table for ModelTable<K> {
    fn common(&self) -> &CommonSettings {
        &self.common
    }

    fn kind_settings(&self) -> &dyn ModelKind {
        &self.kind_settings
    }

    fn kind_settings_mut(&mut self) -> &mut dyn ModelKind {
        &mut self.kind_settings
    }
}

impl ModelConfig {
    /// Returns the name under which peers request the model.
    pub fn name(&self) -> &Slug {
        &self.common().name
    }

    /// Returns the configured device.
    pub fn device(&self) -> &str {
        &self.common().device
    }

    /// Returns the number of worker threads; 1 for `echo`, which runs on the thread of its caller.
    pub fn workers(&self) -> usize {
        self.common().workers.get()
    }

    /// Returns the maximum number of samples that wait for a free worker.
    pub fn queue(&self) -> usize {
        self.common().queue.get()
    }

    /// Returns whether the model runs a custom program. The program's arguments are published only as a fingerprint.
    pub fn is_program(&self) -> bool {
        self.kind_settings().is_program()
    }

    /// Returns the environment variables that the configuration sets for the processes of custom code; `None` if the
    /// kind has none.
    pub fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        self.kind_settings_mut().env_mut()
    }

    /// Returns the setting of the seed of the model's random numbers, which may be missing; `None` if the kind uses no
    /// random numbers.
    pub fn seed_mut(&mut self) -> Option<&mut Option<u64>> {
        self.kind_settings_mut().seed_mut()
    }

    /// Hides the values of `env`, which must not be published.
    pub fn hide_secrets(&mut self) {
        self.env_mut().into_iter().for_each(hide_values);
    }

    /// Checks the numbers against their upper limits.
    ///
    /// # Errors
    /// [`LoadError::AboveLimit`] for the first number above its limit.
    pub fn check_limits(&self) -> Result<(), LoadError> {
        let common_limits = [("workers", self.workers(), MAX_WORKERS), ("queue", self.queue(), MAX_QUEUE)];
        match common_limits
            .into_iter()
            .chain(self.kind_settings().limits())
            .find(|(_, value, max)| value > max)
        {
            Some((key, value, max)) => {
                Err(LoadError::AboveLimit { key, value: value as u64, max: max as u64 })
            }
            None => Ok(()),
        }
    }

    /// Checks the configuration without loading the model or running custom code.
    pub(crate) fn check(&self, context: &LoadContext<'_>) -> Result<(), LoadError> {
        self.kind_settings().check(self.common(), context)
    }

    /// Loads the part of the model that all workers share. Blocks.
    pub(crate) fn load(&self, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
        self.kind_settings().load(self.common(), context)
    }
}

#[cfg(test)]
mod tests;
