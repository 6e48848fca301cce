//! Model kind `onnx`: models in ONNX form, run by ONNX Runtime.
//!
//! A model is a folder with `model.onnx` and its card `model.toml`, which defines the conversion of samples to the
//! inputs and of the outputs to an answer ([`card`]). The library is found and loaded at run time ([`library`]), so
//! that one binary serves hosts with and without GPUs.

mod answer;
mod card;
mod card_match;
mod card_text;
mod classify;
mod config;
mod data_type;
mod detection;
mod device;
mod example;
mod geometry;
mod inputs;
mod library;
mod library_log;
mod model_files;
mod numbers;
mod outputs;
mod picture;
mod regular_file;
mod search;
mod segment;
mod session;
mod shared_model;
mod summary;
mod termination;
mod worker;

pub use config::{OnnxConfig, OnnxRuntimeConfig, check_library};
pub(crate) use example::example_sample;
pub(crate) use model_files::model_files;
pub use summary::CardSummary;
pub(crate) use summary::{hash_card, hash_model, summarise};

use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::Arc;

use peernet_clock::SharedClock;
use peernet_logger::{Slug, fact};
use peernet_sample::{MaskLabel, ObjectsLabel, list_examples, normalized_label};
use tokio_util::sync::CancellationToken;

use super::{CommonSettings, LoadContext};
use crate::{Batching, LoadError, Model, Worker};
use card::Card;
use device::Device;
pub use library::is_library_in_use;
use library::{LibraryUse, Runtime};
use shared_model::SharedModel;
use worker::OnnxWorker;

/// Name of the model's file in its folder.
pub(crate) const MODEL: &str = "model.onnx";

/// Name of the card in a model's folder.
pub(crate) const CARD: &str = "model.toml";

/// Name of the fact with the SHA-256 of the model's files, in hexadecimal.
pub const MODEL_HASH: &str = "Model SHA-256";

/// Name of the fact with the SHA-256 of the model's card, in hexadecimal.
const CARD_HASH: &str = "Card SHA-256";

/// Checks the name of a device.
///
/// # Errors
/// If no device has this name.
pub(crate) fn check_device(name: &str) -> Result<(), LoadError> {
    name.parse::<Device>().map(drop)
}

/// Loaded ONNX model.
struct Onnx {
    settings: Arc<ModelSettings>,
    hash: String,
    card_hash: String,
    runtime: Arc<Runtime>,
    /// Optimised model whose weights several workers share; `None` if the workers share nothing, see
    /// [`SharedModel::prepare`].
    shared: Option<SharedModel>,
    /// Cancelled when the bank of models shuts down; terminates running computations.
    stop: CancellationToken,
    clock: SharedClock,
}

/// Settings and card of a model. They are read before a session of ONNX Runtime is opened.
struct ModelSettings {
    name: Slug,
    file: PathBuf,
    card: Card,
    /// The card's labels in the form in which labels are compared; `None` if the task has no classes.
    classes: Option<HashSet<String>>,
    device: Device,
    workers: usize,
    intra_threads: usize,
    inter_threads: usize,
    batching: Batching,
}

impl Onnx {
    /// Checks everything that can be checked without loading the model: the device, the files, the card, the library.
    fn check(
        config: &OnnxConfig,
        common: &CommonSettings,
        context: &LoadContext<'_>,
    ) -> Result<(), LoadError> {
        Self::read_settings(config, common, context).map(drop)
    }

    /// Loads the part of the model that all workers share.
    fn load(
        config: &OnnxConfig,
        common: &CommonSettings,
        context: &LoadContext<'_>,
    ) -> Result<Self, LoadError> {
        let (settings, runtime) = Self::read_settings(config, common, context)?;
        let _library_use = LibraryUse::begin();
        let (hash, card_hash) = (hash_model(&config.path)?, hash_card(&config.path)?);
        let shared = SharedModel::prepare(&settings, &runtime, context.temp_dirs)?;
        let (stop, clock) = (context.stop.clone(), Arc::clone(context.clock));
        Ok(Self { settings: Arc::new(settings), hash, card_hash, runtime, shared, stop, clock })
    }

    fn read_settings(
        config: &OnnxConfig,
        common: &CommonSettings,
        context: &LoadContext<'_>,
    ) -> Result<(ModelSettings, Arc<Runtime>), LoadError> {
        let device: Device = common.device.parse()?;
        let card = Card::read(&config.path.join(CARD))?;
        // The call checks the files. The names of the files are not needed here.
        model_files(&config.path)?;
        let file = config.path.join(MODEL);
        let runtime = Runtime::get(context.runtime, context.clock)?;
        device.check(&common.name, runtime.library())?;
        let settings = ModelSettings {
            name: common.name.clone(),
            file,
            classes: card
                .task
                .labels()
                .map(|labels| labels.iter().map(|label| normalized_label(label)).collect()),
            card,
            device,
            workers: common.workers.get(),
            intra_threads: config.intra_threads.get(),
            inter_threads: config.inter_threads.get(),
            batching: config.batching(),
        };
        Ok((settings, runtime))
    }
}

impl ModelSettings {
    /// Returns whether the model could give the answer that a label expects. It could if it has all classes of the
    /// label, or if its task has no classes.
    fn has_classes_of(&self, label: &str) -> bool {
        let Some(classes) = &self.classes else { return true };
        let has = |class: &str| classes.contains(&normalized_label(class));
        // Only the sensor's host has the mask and knows its classes. The sensor's host compares the classes when it
        // scores the answer.
        if MaskLabel::parse(label).is_some() {
            return true;
        }
        match ObjectsLabel::parse(label) {
            Some(label) => label.objects.iter().all(|object| has(&object.label)),
            None => has(label),
        }
    }
}

impl Model for Onnx {
    fn create_worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        let library_use = LibraryUse::begin();
        let session = session::open(&self.settings, &self.runtime, self.shared.as_ref())?;
        let settings = Arc::clone(&self.settings);
        let (stop, clock) = (self.stop.clone(), Arc::clone(&self.clock));
        Ok(Box::new(OnnxWorker::new_warmed_up(settings, session, library_use, stop, clock)?))
    }

    fn batching(&self) -> Batching {
        self.settings.batching
    }

    fn device(&self) -> String {
        self.settings.device.to_string()
    }

    fn facts(&self) -> Vec<(String, String)> {
        let ModelSettings { card, device, intra_threads, inter_threads, .. } = &*self.settings;
        let facts = [
            Some(("Model", format!("{} {}", card.name, card.version).trim_end().to_owned())),
            Some((MODEL_HASH, self.hash.clone())),
            Some((CARD_HASH, self.card_hash.clone())),
            Some(("Task", card.description.clone())),
            Some(("Input", card.summary().input)),
            card.task.labels().map(|labels| (fact::CLASSES, describe_classes(labels))),
            Some(("Device", device.to_string())),
            Some(("Threads per worker", format!("{intra_threads} within operators, {inter_threads} across"))),
            Some(("ONNX Runtime", self.runtime.describe())),
        ];
        facts.into_iter().flatten().map(|(name, value)| (name.to_owned(), value)).collect()
    }
}

/// Returns the number of classes and the names of the first classes.
fn describe_classes(labels: &[String]) -> String {
    format!("{}: {}", labels.len(), list_examples(labels.iter().map(String::as_str)))
}
