//! The kinds of models: one file or folder for each, and the registration of each in [`ModelConfig`].

pub mod echo;
pub mod exec;
pub mod onnx;
pub mod python;
mod settings;
pub mod sleep;
mod table;

pub use table::{Keys, ModelTable, SharedKeys};

use std::sync::Arc;

use enum_dispatch::enum_dispatch;
use peernet_clock::SharedClock;
use peernet_external::exec::FingerprintKey;
use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use crate::litter::Litter;
use crate::{LoadError, Model};
use onnx::OnnxRuntimeConfig;

/// Most threads that compute samples of one model.
const MAX_WORKERS: usize = 256;
/// Most samples that may wait for one model.
const MAX_QUEUE: usize = 65_536;

/// A kind of model, implemented by the keys that it has beside the shared ones.
pub trait ModelKind {
    /// The shared keys that a model of this kind has; `name` is one of them. Default: all.
    ///
    /// A kind whose [`Model::blocks`] is false has no `workers` and no `queue`: it runs on the thread of its caller.
    fn shared_keys() -> &'static [&'static str]
    where
        Self: Sized,
    {
        SharedKeys::names()
    }

    /// Own keys whose values stand elsewhere in a run's description, or tell where things are on this host, which is nobody's
    /// business.
    fn untold_keys(&self) -> &'static [&'static str] {
        &[]
    }

    /// Own numbers: key, value and upper limit.
    fn limits(&self) -> Vec<(&'static str, usize, usize)> {
        Vec::new()
    }

    /// Whether it runs a program of the user's own, whose arguments are told by their fingerprint alone.
    fn is_program(&self) -> bool {
        false
    }

    /// What tells programs with different arguments apart, as a fact; the arguments themselves may be secret.
    fn arguments(&self, _key: &FingerprintKey) -> Option<(String, String)> {
        None
    }

    /// Takes out what may not be published: the values of `env`.
    fn hide_secrets(&mut self) {}

    /// Takes out keys that are not told when they have their defaults.
    // Settings of runs are compared as texts: a default that earlier versions did not tell would be a difference.
    fn leave_out_defaults(&self, _keys: &mut Keys) {}

    /// Finds what is wrong without loading the model or running a user's code.
    ///
    /// # Errors
    /// When the configuration contradicts itself, or what it names is not there.
    fn check(&self, _shared: &SharedKeys, _context: &LoadContext<'_>) -> Result<(), LoadError> {
        Ok(())
    }

    /// Loads what all workers share. Blocks.
    ///
    /// # Errors
    /// When it cannot be loaded.
    fn load(&self, shared: &SharedKeys, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError>;
}

/// What a model may need of its surroundings when it is loaded.
#[derive(Debug)]
pub struct LoadContext<'a> {
    /// `[onnxruntime]`.
    pub(crate) runtime: &'a OnnxRuntimeConfig,
    /// Where temporary folders are entered.
    pub(crate) litter: &'a Litter,
    /// What deadlines are taken from.
    pub(crate) clock: &'a SharedClock,
}

/// `[[model]]`: one model that this host offers. A new kind is registered here.
#[enum_dispatch(Table)]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum ModelConfig {
    /// A model in ONNX form, run by ONNX Runtime.
    Onnx(ModelTable<onnx::OnnxConfig>),
    /// A Python object of the user's own with `infer(x)`.
    Python(ModelTable<python::PythonConfig>),
    /// A program of your own: docs/external-programs.md.
    Exec(ModelTable<exec::ExecConfig>),
    /// Answers with what it was given, at once: measures everything around a model.
    Echo(ModelTable<echo::EchoConfig>),
    /// Takes the time it is told to: a model of known latency.
    Sleep(ModelTable<sleep::SleepConfig>),
}

/// A model's table, whatever its kind.
#[enum_dispatch]
pub(crate) trait Table {
    fn shared(&self) -> &SharedKeys;
    fn own(&self) -> &dyn ModelKind;
    fn own_mut(&mut self) -> &mut dyn ModelKind;
}

impl<K: ModelKind + 'static> Table for ModelTable<K> {
    fn shared(&self) -> &SharedKeys {
        &self.shared
    }

    fn own(&self) -> &dyn ModelKind {
        &self.own
    }

    fn own_mut(&mut self) -> &mut dyn ModelKind {
        &mut self.own
    }
}

impl ModelConfig {
    /// The name under which peers ask for it.
    pub fn name(&self) -> &Slug {
        &self.shared().name
    }

    /// The device it is configured for.
    pub fn device(&self) -> &str {
        &self.shared().device
    }

    /// Threads that compute; `echo` runs on the thread of its caller and counts as one.
    pub fn workers(&self) -> usize {
        self.shared().workers.get()
    }

    /// Samples that may wait for a free worker.
    pub fn queue(&self) -> usize {
        self.shared().queue.get()
    }

    /// Whether it runs a program of the user's own, whose arguments are told by their fingerprint alone.
    pub fn is_program(&self) -> bool {
        self.own().is_program()
    }

    /// Takes out what may not be published: the values of `env`.
    pub fn hide_secrets(&mut self) {
        self.own_mut().hide_secrets();
    }

    /// Checks the numbers against their upper limits.
    ///
    /// # Errors
    /// [`LoadError::TooMuch`] for the first that is beyond its own.
    pub fn check_limits(&self) -> Result<(), LoadError> {
        let of_all = [("workers", self.workers(), MAX_WORKERS), ("queue", self.queue(), MAX_QUEUE)];
        match of_all.into_iter().chain(self.own().limits()).find(|(_, value, most)| value > most) {
            Some((key, value, most)) => {
                Err(LoadError::TooMuch { key, value: value as u64, most: most as u64 })
            }
            None => Ok(()),
        }
    }

    /// Finds what is wrong without loading the model or running a user's code.
    pub(crate) fn check(&self, context: &LoadContext<'_>) -> Result<(), LoadError> {
        self.own().check(self.shared(), context)
    }

    /// Loads what all workers share. Blocks.
    pub(crate) fn load(&self, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
        self.own().load(self.shared(), context)
    }
}

#[cfg(test)]
mod tests;
