//! The models that a host offers.

use std::collections::HashSet;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use peernet_clock::SharedClock;
use peernet_logger::Slug;

use crate::echo::Echo;
use crate::onnx::Onnx;
use crate::pool::Sizes;
use crate::sleep::Sleep;
use crate::{LoadError, Model, ModelConfig, OnnxRuntimeConfig, Pool};

/// The models that a host offers, loaded when they are first asked for and shared from then on.
pub struct Bank {
    shelves: Vec<Shelf>,
    runtime: OnnxRuntimeConfig,
    clock: SharedClock,
    on_load: Option<Observer>,
}

type Observer = Box<dyn Fn(&Pool) + Send + Sync>;

/// One model: its lock is held while it loads, so that it loads once and the others are not held up.
struct Shelf {
    config: ModelConfig,
    pool: Mutex<Option<Arc<Pool>>>,
}

impl Bank {
    /// A bank of these models; nothing is loaded yet.
    pub fn new(models: Vec<ModelConfig>, runtime: OnnxRuntimeConfig, clock: SharedClock) -> Self {
        let shelves = models.into_iter().map(|config| Shelf { config, pool: Mutex::new(None) }).collect();
        Self { shelves, runtime, clock, on_load: None }
    }

    /// Calls `observer` with each pool right after it was loaded; [`Pool::loaded_in`] tells how long it took.
    #[must_use]
    pub fn on_load(mut self, observer: impl Fn(&Pool) + Send + Sync + 'static) -> Self {
        self.on_load = Some(Box::new(observer));
        self
    }

    /// The names of the models, in the order of the configuration.
    pub fn names(&self) -> Vec<Slug> {
        self.shelves.iter().map(|shelf| shelf.config.name().clone()).collect()
    }

    /// The configuration of each model, in order.
    pub fn models(&self) -> impl Iterator<Item = &ModelConfig> {
        self.shelves.iter().map(|shelf| &shelf.config)
    }

    /// The pool of a model, loading it if nobody did yet. `device` is what the asker insists on, `None` for
    /// whatever is configured.
    ///
    /// Blocks while the model loads, which may take seconds: not for an I/O thread.
    ///
    /// # Errors
    /// When there is no such model, or not on that device, or when it cannot be loaded; the next call tries
    /// again.
    pub fn load(&self, name: &Slug, device: Option<&str>) -> Result<Arc<Pool>, LoadError> {
        let shelf = self.shelves.iter().find(|shelf| shelf.config.name() == name).ok_or_else(|| {
            let known = self.names().iter().map(Slug::to_string).collect();
            LoadError::UnknownModel { name: name.to_string(), known }
        })?;
        let offered = shelf.config.device();
        if let Some(asked) = device.filter(|asked| *asked != offered) {
            let (model, asked, offered) = (name.to_string(), asked.to_owned(), offered.to_owned());
            return Err(LoadError::OtherDevice { model, asked, offered });
        }
        // A panic while loading leaves the shelf empty, which is a valid state.
        let mut place = shelf.pool.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pool) = place.as_ref() {
            return Ok(Arc::clone(pool));
        }
        let pool = Arc::new(self.start(&shelf.config)?);
        *place = Some(Arc::clone(&pool));
        drop(place);
        if let Some(observer) = &self.on_load {
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
            if let ModelConfig::Onnx(config) = config
                && let Err(error) = Onnx::check(config, &self.runtime)
            {
                errors.push((index, error));
            }
        }
        errors
    }

    /// Ends the threads of all models that were loaded; see [`Pool::shutdown`]. Blocks.
    pub fn shutdown(&self) {
        for shelf in &self.shelves {
            let pool = shelf.pool.lock().unwrap_or_else(PoisonError::into_inner).take();
            if let Some(pool) = pool {
                pool.shutdown();
            }
        }
    }

    fn start(&self, config: &ModelConfig) -> Result<Pool, LoadError> {
        let begun = self.clock.mono();
        let model: Arc<dyn Model> = match config {
            ModelConfig::Onnx(config) => Arc::new(Onnx::load(config, &self.runtime)?),
            ModelConfig::Echo(config) => Arc::new(Echo::new(config.clone())),
            ModelConfig::Sleep(config) => Arc::new(Sleep::new(config.clone())),
        };
        let sizes = Sizes { workers: config.workers(), queue: config.queue() };
        Pool::start(config.name().clone(), model, sizes, &self.clock, begun)
    }
}

impl fmt::Debug for Bank {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bank").field("models", &self.names()).finish_non_exhaustive()
    }
}
