//! The models that a host offers: models of its configuration, and models in its model folders.

mod cache_entry;
mod config;
mod folders;
mod load_watch;
mod model_cache;
mod unloaded_model;

pub use config::BankConfig;
pub use folders::{DEFAULT_MODEL_FOLDER, ModelFolders, ModelOnDisk};
pub use load_watch::LOAD_LOG_TARGET;
pub use unloaded_model::{UnloadReason, UnloadedModel};

use std::collections::HashSet;
use std::fmt;
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Duration;

use peernet_clock::{SharedClock, Span};
use peernet_external::exec::FingerprintKey;
use peernet_logger::Slug;
use tokio_util::sync::CancellationToken;

use crate::loaded_models::LoadedModelCounter;
use crate::model::LoadContext;
use crate::pool::Sizes;
use crate::temp_dirs::TempDirs;
use crate::{LoadError, LoadedModels, ModelConfig, OnnxRuntimeConfig, Pool, ProcessMemory};

use cache_entry::CacheEntry;
use load_watch::LoadWatch;
use model_cache::ModelCache;

/// Models that a host offers. A model is loaded when it is first requested; later requests share the loaded model.
pub struct Bank {
    /// The configured models, which stay loaded.
    entries: Vec<Arc<CacheEntry>>,
    /// Name of a model in `entries` that is used only if it is requested by name.
    built_in: Option<Slug>,
    /// The models of the folders, which are loaded when they are requested and unloaded to make room for others.
    cache: Option<ModelCache>,
    temp_dirs: TempDirs,
    runtime: OnnxRuntimeConfig,
    clock: SharedClock,
    loaded: LoadedModelCounter,
    on_load: Option<LoadObserver>,
    on_unload: Option<UnloadObserver>,
    fingerprint_key: Option<FingerprintKey>,
    /// Cancelled by a shutdown, so that models stop computing where they can.
    stop: CancellationToken,
}

type LoadObserver = Box<dyn Fn(&Pool) + Send + Sync>;
type UnloadObserver = Arc<dyn Fn(&UnloadedModel) + Send + Sync>;

impl Bank {
    /// Creates a bank of these models; loads none of them.
    pub fn new(models: Vec<ModelConfig>, runtime: OnnxRuntimeConfig, clock: SharedClock) -> Self {
        let entries = models.into_iter().map(|config| CacheEntry::new(config, None)).collect();
        Self {
            entries,
            built_in: None,
            cache: None,
            temp_dirs: TempDirs::default(),
            runtime,
            clock,
            loaded: LoadedModelCounter::default(),
            on_load: None,
            on_unload: None,
            fingerprint_key: None,
            stop: CancellationToken::new(),
        }
    }

    /// Adds a key for fingerprints. Facts then identify the arguments of programs by fingerprints made with this key.
    #[must_use]
    pub fn with_fingerprint_key(mut self, key: FingerprintKey) -> Self {
        self.fingerprint_key = Some(key);
        self
    }

    /// Adds a model that is used only if it is requested by name.
    #[must_use]
    pub fn with_built_in(mut self, model: ModelConfig) -> Self {
        self.built_in = Some(model.name().clone());
        self.entries.push(CacheEntry::new(model, None));
        self
    }

    /// Adds the models of these folders. A configured model takes precedence over a model of the same name.
    #[must_use]
    pub fn with_folders(mut self, config: BankConfig) -> Self {
        self.cache = Some(ModelCache::new(config));
        self
    }

    /// Calls `observer` with the pool of each model after the model was loaded; [`Pool::load_duration`] is the duration
    /// of loading.
    #[must_use]
    pub fn on_load(mut self, observer: impl Fn(&Pool) + Send + Sync + 'static) -> Self {
        self.on_load = Some(Box::new(observer));
        self
    }

    /// Calls `observer` with each model after the model was unloaded. A model of the folders is unloaded to make room
    /// or because its files have changed; [`shutdown`](Self::shutdown) unloads all models.
    #[must_use]
    pub fn on_unload(mut self, observer: impl Fn(&UnloadedModel) + Send + Sync + 'static) -> Self {
        self.on_unload = Some(Arc::new(observer));
        self
    }

    /// Returns the number and the memory of the models that are loaded now. Does not block while a model loads.
    pub fn loaded_models(&self) -> LoadedModels {
        self.loaded.get()
    }

    /// Returns the names of the configured models, in the order of the configuration, and of the built-in model.
    pub fn names(&self) -> Vec<Slug> {
        self.models().map(|model| model.name().clone()).collect()
    }

    /// Returns the configurations of the configured models and of the built-in model, in the order of
    /// [`names`](Self::names).
    pub fn models(&self) -> impl Iterator<Item = &ModelConfig> {
        self.entries.iter().map(|entry| &entry.config)
    }

    /// Returns the names of all models that can be requested except the built-in one: the configured models, then the
    /// models that are in the folders now. Reads the folders.
    pub fn offered_names(&self) -> Vec<Slug> {
        let mut names = self.configured_names();
        for name in self.cache.iter().flat_map(ModelCache::names) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// Returns the name of the model for requests that name no model: the only configured model or, if none is
    /// configured, the only model of the folders. The built-in model does not count.
    ///
    /// # Errors
    /// If there are several such models, or none.
    pub fn default_model(&self) -> Result<Slug, LoadError> {
        let configured = self.configured_names();
        let names = if configured.is_empty() { self.offered_names() } else { configured };
        match &*names {
            [name] => Ok(name.clone()),
            _ => Err(LoadError::Unnamed { known: names.iter().map(Slug::to_string).collect() }),
        }
    }

    fn configured_names(&self) -> Vec<Slug> {
        self.names().into_iter().filter(|name| self.built_in.as_ref() != Some(name)).collect()
    }

    /// Returns the pool of a model; loads the model if it is not loaded.
    ///
    /// `device` is the requested device; `None` stands for the configured device or, for a model of the folders, for
    /// the first offered device. A model of the folders stays loaded while its pool is in use. Blocks while the model
    /// loads, which may take seconds; must not be called on an I/O thread.
    ///
    /// # Errors
    /// If the model does not exist, is not offered on that device or cannot be loaded, or if too many models of the
    /// folders are in use. The next call tries again.
    pub fn load(&self, name: &Slug, device: Option<&str>) -> Result<Arc<Pool>, LoadError> {
        let Some(entry) = self.entries.iter().find(|entry| entry.config.name() == name) else {
            return self.load_from_folders(name, device);
        };
        let configured = entry.config.device();
        if let Some(requested) = device.filter(|requested| *requested != configured) {
            let (model, requested, offered) = (name.to_string(), requested.to_owned(), configured.to_owned());
            return Err(LoadError::OtherDevice { model, requested, offered });
        }
        self.load_entry(entry)
    }

    fn load_from_folders(&self, name: &Slug, device: Option<&str>) -> Result<Arc<Pool>, LoadError> {
        let unknown = || {
            let known = self.offered_names().iter().map(Slug::to_string).collect();
            LoadError::UnknownModel { name: name.to_string(), known }
        };
        let cache = self.cache.as_ref().ok_or_else(unknown)?;
        let (entry, to_unload) = cache.entry(name, device).map_err(|error| match error {
            // A peer learns which models exist, but not in which folders.
            LoadError::NotFound { .. } => unknown(),
            error => error,
        })?;
        // The old models are unloaded before the new one is loaded, so that the limit is never exceeded.
        for (old, reason) in to_unload {
            self.unloader().unload(&old, reason);
        }
        let pool = self.load_entry(&entry);
        if pool.is_err() {
            // The next request reads the files again, because the user may have corrected them.
            cache.discard(&entry);
        }
        pool
    }

    fn load_entry(&self, entry: &CacheEntry) -> Result<Arc<Pool>, LoadError> {
        // The observer is called after the lock of the entry is released, so that a slow observer delays no other
        // request.
        let (pool, is_new) = entry.pool(|| self.start_pool(&entry.config))?;
        if let Some(observer) = self.on_load.as_ref().filter(|_| is_new) {
            observer(&pool);
        }
        Ok(pool)
    }

    fn unloader(&self) -> Unloader {
        Unloader { clock: Arc::clone(&self.clock), observer: self.on_unload.clone() }
    }

    /// Checks everything that can be checked without loading a model: names, files, cards, devices, ONNX Runtime.
    /// Returns each error with the position of its model in the configuration.
    pub fn check(&self) -> Vec<(usize, LoadError)> {
        let mut errors = Vec::new();
        let mut seen_names = HashSet::new();
        for (index, config) in self.models().enumerate() {
            if !seen_names.insert(config.name()) {
                errors.push((index, LoadError::Duplicate(config.name().to_string())));
            }
            // Each check adds its own error, so that a user can correct all errors at once.
            if let Err(error) = config.check_limits() {
                errors.push((index, error));
            }
            if let Err(error) = config.check(&self.context()) {
                errors.push((index, error));
            }
        }
        errors
    }

    /// Checks the table `[bank]`; returns each error with its key. Errors of single models in the folders are not
    /// included, because a model with an error is not offered.
    pub fn check_folders(&self) -> Vec<(&'static str, LoadError)> {
        self.cache.as_ref().map(ModelCache::check).unwrap_or_default()
    }

    /// Ends the threads of all loaded models; see [`Pool::shutdown`]. Blocks.
    pub fn shutdown(&self) {
        for entry in self.all_entries() {
            self.unloader().unload(&entry, UnloadReason::Shutdown);
        }
    }

    fn all_entries(&self) -> Vec<Arc<CacheEntry>> {
        self.entries.iter().cloned().chain(self.cache.iter().flat_map(ModelCache::entries)).collect()
    }

    /// Ends the threads of all loaded models, but waits no longer than `timeout`. Blocks.
    ///
    /// Returns the models that are still loading or computing. The threads of these models are left running, and their
    /// temporary files are removed.
    pub fn shutdown_within(&self, timeout: Duration) -> Vec<Slug> {
        self.stop.cancel();
        // Loading or computing may take minutes, for which the end of the process must not wait.
        let deadline =
            self.clock.mono() + Span::from_nanos(i64::try_from(timeout.as_nanos()).unwrap_or(i64::MAX));
        let entries = self.all_entries();
        // The channel has a place for each model, so that a thread that ends after the deadline does not wait for a
        // receiver.
        let (ended_sender, ended_receiver) = mpsc::sync_channel(entries.len());
        let mut running: Vec<(usize, Slug)> =
            entries.iter().enumerate().map(|(index, entry)| (index, entry.config.name().clone())).collect();
        for (index, entry) in entries.into_iter().enumerate() {
            let (ended_sender, unloader) = (ended_sender.clone(), self.unloader());
            let thread = thread::Builder::new().name(format!("end-{}", entry.config.name()));
            let spawned = thread.spawn(move || {
                unloader.unload(&entry, UnloadReason::Shutdown);
                // The receiver no longer exists if unloading this model took too long.
                let _ = ended_sender.send(index);
            });
            if let Err(error) = spawned {
                tracing::error!(%error, "cannot start a thread to end a model");
            }
        }
        // From here on, only the threads hold senders. The loop therefore ends as soon as all threads have ended, even
        // if a thread could not be started.
        drop(ended_sender);
        while !running.is_empty() {
            let remaining = (deadline - self.clock.mono()).nanos().max(0).unsigned_abs();
            match ended_receiver.recv_timeout(Duration::from_nanos(remaining)) {
                Ok(index) => running.retain(|(other, _)| *other != index),
                Err(_) => break,
            }
        }
        if !running.is_empty() {
            self.temp_dirs.delete_all();
        }
        running.into_iter().map(|(_, name)| name).collect()
    }

    fn context(&self) -> LoadContext<'_> {
        LoadContext {
            runtime: &self.runtime,
            temp_dirs: &self.temp_dirs,
            clock: &self.clock,
            models: self.models().collect(),
            stop: &self.stop,
        }
    }

    /// Loads a model and starts its pool.
    fn start_pool(&self, config: &ModelConfig) -> Result<Pool, LoadError> {
        config.check_limits()?;
        let started_at = self.clock.mono();
        let _watch = LoadWatch::start(config.name(), config.device());
        let memory_before = resident_memory();
        // The growth includes the creation of the workers, because a worker may have its own copy of the weights.
        let model = config.load(&self.context())?;
        let sizes = Sizes { workers: config.workers(), queue: config.queue() };
        let pool = Pool::start(config.name().clone(), model, sizes, &self.clock, started_at)?;
        let memory_growth =
            memory_before.zip(resident_memory()).map(|(before, after)| after.saturating_sub(before));
        Ok(pool
            .with_facts(config.facts(self.fingerprint_key.as_ref()))
            .with_memory_growth(memory_growth, &self.loaded))
    }
}

/// Unloads models and calls the observer.
struct Unloader {
    clock: SharedClock,
    observer: Option<UnloadObserver>,
}

impl Unloader {
    /// Ends the threads of the model, if it is loaded. Blocks.
    fn unload(&self, entry: &CacheEntry, reason: UnloadReason) {
        let Some(pool) = entry.take() else { return };
        let (name, device, loaded_at) = (pool.name().clone(), pool.device(), pool.loaded_at());
        let memory_before = resident_memory();
        pool.shutdown();
        // The pool owns the model. Dropping the pool releases the model's memory before the resident memory is read
        // again.
        drop(pool);
        // A shutdown unloads all models at the same time. How much memory one of them released is then unknown.
        let memory_before = memory_before.filter(|_| reason != UnloadReason::Shutdown);
        let memory_released =
            memory_before.zip(resident_memory()).map(|(before, after)| before.saturating_sub(after));
        let loaded_for = self.clock.mono() - loaded_at;
        if let Some(observer) = &self.observer {
            observer(&UnloadedModel { name, device, loaded_for, memory_released, reason });
        }
    }
}

/// Returns the resident memory of this process, bytes.
fn resident_memory() -> Option<u64> {
    ProcessMemory::read().map(|memory| memory.resident)
}

impl fmt::Debug for Bank {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bank").field("models", &self.names()).finish_non_exhaustive()
    }
}
