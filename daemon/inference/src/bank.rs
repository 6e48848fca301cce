//! The models that a host offers: those of its configuration, and those in its folders.

mod config;
mod folders;
mod shelf;
mod stock;

pub use config::BankConfig;
pub use folders::{INSTALLED, ModelFolders, ModelOnDisk};

use std::collections::HashSet;
use std::fmt;
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Duration;

use peernet_clock::{SharedClock, Span};
use peernet_external::exec::FingerprintKey;
use peernet_logger::Slug;

use crate::litter::Litter;
use crate::model::LoadContext;
use crate::pool::Sizes;
use crate::{LoadError, ModelConfig, OnnxRuntimeConfig, Pool};

use shelf::Shelf;
use stock::Stock;

/// The models that a host offers, loaded when they are first asked for and shared from then on.
pub struct Bank {
    /// The configured models, which stay.
    shelves: Vec<Arc<Shelf>>,
    /// The name of one of them that is nobody's first choice.
    built_in: Option<Slug>,
    /// The models of the folders, which come and go.
    stock: Option<Stock>,
    litter: Litter,
    runtime: OnnxRuntimeConfig,
    clock: SharedClock,
    on_load: Option<Observer>,
    fingerprints: Option<FingerprintKey>,
}

type Observer = Box<dyn Fn(&Pool) + Send + Sync>;

impl Bank {
    /// A bank of these models; nothing is loaded yet.
    pub fn new(models: Vec<ModelConfig>, runtime: OnnxRuntimeConfig, clock: SharedClock) -> Self {
        let shelves = models.into_iter().map(|config| Shelf::new(config, None)).collect();
        Self {
            shelves,
            built_in: None,
            stock: None,
            litter: Litter::default(),
            runtime,
            clock,
            on_load: None,
            fingerprints: None,
        }
    }

    /// Facts tell programs with different arguments apart, by fingerprints made with this key.
    #[must_use]
    pub fn with_fingerprints(mut self, key: FingerprintKey) -> Self {
        self.fingerprints = Some(key);
        self
    }

    /// One more model, which only those get who ask for it by name.
    #[must_use]
    pub fn with_built_in(mut self, model: ModelConfig) -> Self {
        self.built_in = Some(model.name().clone());
        self.shelves.push(Shelf::new(model, None));
        self
    }

    /// The models of these folders as well. A configured one of the same name goes first.
    #[must_use]
    pub fn with_folders(mut self, config: BankConfig) -> Self {
        self.stock = Some(Stock::new(config));
        self
    }

    /// Calls `observer` with each pool right after it was loaded; [`Pool::loaded_in`] tells how long it took.
    #[must_use]
    pub fn on_load(mut self, observer: impl Fn(&Pool) + Send + Sync + 'static) -> Self {
        self.on_load = Some(Box::new(observer));
        self
    }

    /// The names of the configured models, in the order of the configuration.
    pub fn names(&self) -> Vec<Slug> {
        self.models().map(|model| model.name().clone()).collect()
    }

    /// The configuration of each configured model, in order.
    pub fn models(&self) -> impl Iterator<Item = &ModelConfig> {
        self.shelves.iter().map(|shelf| &shelf.config)
    }

    /// The names of all models that can be asked for but the built-in one: the configured ones, then those of the folders
    /// as they are now. Reads the folders.
    pub fn offered(&self) -> Vec<Slug> {
        let mut names = self.configured();
        for name in self.stock.iter().flat_map(Stock::names) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// The model for those who name none: the only configured one or, if there is none, the only one of the folders. The
    /// built-in one does not count.
    ///
    /// # Errors
    /// When there are several, or none at all.
    pub fn only(&self) -> Result<Slug, LoadError> {
        let configured = self.configured();
        let names = if configured.is_empty() { self.offered() } else { configured };
        match &*names {
            [name] => Ok(name.clone()),
            _ => Err(LoadError::Unnamed { known: names.iter().map(Slug::to_string).collect() }),
        }
    }

    fn configured(&self) -> Vec<Slug> {
        self.names().into_iter().filter(|name| self.built_in.as_ref() != Some(name)).collect()
    }

    /// The pool of a model, loading it if nobody did yet. `device` is what the asker insists on, `None` for
    /// whatever is configured. A model of the folders stays in memory for as long as somebody keeps its pool.
    ///
    /// Blocks while the model loads, which may take seconds: not for an I/O thread.
    ///
    /// # Errors
    /// When there is no such model, or not on that device, or when it cannot be loaded, or when too many models of the
    /// folders are in use; the next call tries again.
    pub fn load(&self, name: &Slug, device: Option<&str>) -> Result<Arc<Pool>, LoadError> {
        let Some(shelf) = self.shelves.iter().find(|shelf| shelf.config.name() == name) else {
            return self.load_from_folders(name, device);
        };
        let offered = shelf.config.device();
        if let Some(asked) = device.filter(|asked| *asked != offered) {
            let (model, asked, offered) = (name.to_string(), asked.to_owned(), offered.to_owned());
            return Err(LoadError::OtherDevice { model, asked, offered });
        }
        self.fill(shelf)
    }

    fn load_from_folders(&self, name: &Slug, device: Option<&str>) -> Result<Arc<Pool>, LoadError> {
        let unknown = || {
            let known = self.offered().iter().map(Slug::to_string).collect();
            LoadError::UnknownModel { name: name.to_string(), known }
        };
        let stock = self.stock.as_ref().ok_or_else(unknown)?;
        let shelf = stock.shelf(name, device).map_err(|error| match error {
            // A peer is told what there is, not where.
            LoadError::NotFound { .. } => unknown(),
            error => error,
        })?;
        let pool = self.fill(&shelf);
        if pool.is_err() {
            stock.discard(&shelf);
        }
        pool
    }

    fn fill(&self, shelf: &Shelf) -> Result<Arc<Pool>, LoadError> {
        let (pool, new) = shelf.pool(|| self.start(&shelf.config))?;
        if let Some(observer) = self.on_load.as_ref().filter(|_| new) {
            observer(&pool);
        }
        Ok(pool)
    }

    /// Everything that can be found wrong without loading a model: names, files, cards, devices, the library;
    /// each with the position of its model in the configuration.
    pub fn check(&self) -> Vec<(usize, LoadError)> {
        let mut errors = Vec::new();
        let mut seen = HashSet::new();
        for (index, config) in self.models().enumerate() {
            if !seen.insert(config.name()) {
                errors.push((index, LoadError::Duplicate(config.name().to_string())));
            }
            if let Err(error) = config.check_limits() {
                errors.push((index, error));
            }
            if let Err(error) = config.check(&self.context()) {
                errors.push((index, error));
            }
        }
        errors
    }

    /// The same for the folders; each with its key in `[bank]`. What is wrong with single models there is not told: they
    /// are not offered.
    pub fn check_folders(&self) -> Vec<(&'static str, LoadError)> {
        self.stock.as_ref().map(Stock::check).unwrap_or_default()
    }

    /// Ends the threads of all models that were loaded; see [`Pool::shutdown`]. Blocks.
    pub fn shutdown(&self) {
        for shelf in self.all() {
            shelf.clear();
        }
    }

    fn all(&self) -> Vec<Arc<Shelf>> {
        self.shelves.iter().cloned().chain(self.stock.iter().flat_map(Stock::shelves)).collect()
    }

    /// The same, but waits no longer than `patience`. Returns the models that were not waited for, because they
    /// load or compute: their threads are left to themselves, and their temporary files are removed. Blocks.
    pub fn shutdown_within(&self, patience: Duration) -> Vec<Slug> {
        let deadline =
            self.clock.mono() + Span::from_nanos(i64::try_from(patience.as_nanos()).unwrap_or(i64::MAX));
        let shelves = self.all();
        let (done, ended) = mpsc::sync_channel(shelves.len());
        let mut left: Vec<(usize, Slug)> =
            shelves.iter().enumerate().map(|(index, shelf)| (index, shelf.config.name().clone())).collect();
        for (index, shelf) in shelves.into_iter().enumerate() {
            let done = done.clone();
            let thread = thread::Builder::new().name(format!("end-{}", shelf.config.name()));
            let ending = thread.spawn(move || {
                shelf.clear();
                // Nobody listens any more when this took too long.
                let _ = done.send(index);
            });
            if let Err(error) = ending {
                tracing::error!(%error, "cannot start a thread to end a model");
            }
        }
        drop(done);
        while !left.is_empty() {
            let remaining = (deadline - self.clock.mono()).nanos().max(0).unsigned_abs();
            match ended.recv_timeout(Duration::from_nanos(remaining)) {
                Ok(index) => left.retain(|(other, _)| *other != index),
                Err(_) => break,
            }
        }
        if !left.is_empty() {
            self.litter.sweep();
        }
        left.into_iter().map(|(_, name)| name).collect()
    }

    fn context(&self) -> LoadContext<'_> {
        LoadContext { runtime: &self.runtime, litter: &self.litter, clock: &self.clock }
    }

    fn start(&self, config: &ModelConfig) -> Result<Pool, LoadError> {
        config.check_limits()?;
        let begun = self.clock.mono();
        let model = config.load(&self.context())?;
        let sizes = Sizes { workers: config.workers(), queue: config.queue() };
        let pool = Pool::start(config.name().clone(), model, sizes, &self.clock, begun)?;
        Ok(pool.telling(config.facts(self.fingerprints.as_ref())))
    }
}

impl fmt::Debug for Bank {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bank").field("models", &self.names()).finish_non_exhaustive()
    }
}
