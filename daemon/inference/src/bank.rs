//! The models that a host offers.

use std::collections::HashSet;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread;
use std::time::Duration;

use peernet_clock::{SharedClock, Span};
use peernet_logger::Slug;

use crate::echo::Echo;
use crate::litter::Litter;
use crate::onnx::Onnx;
use crate::pool::Sizes;
use crate::sleep::Sleep;
use crate::{LoadError, Model, ModelConfig, OnnxRuntimeConfig, Pool};

/// The models that a host offers, loaded when they are first asked for and shared from then on.
pub struct Bank {
    shelves: Vec<Arc<Shelf>>,
    litter: Litter,
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
        let shelf = |config| Arc::new(Shelf { config, pool: Mutex::new(None) });
        let shelves = models.into_iter().map(shelf).collect();
        Self { shelves, litter: Litter::default(), runtime, clock, on_load: None }
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
            if let Err(error) = config.check_limits() {
                errors.push((index, error));
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
            shelf.clear();
        }
    }

    /// The same, but waits no longer than `patience`. Returns the models that were not waited for, because they
    /// load or compute: their threads are left to themselves, and their temporary files are removed. Blocks.
    pub fn shutdown_within(&self, patience: Duration) -> Vec<Slug> {
        let deadline =
            self.clock.mono() + Span::from_nanos(i64::try_from(patience.as_nanos()).unwrap_or(i64::MAX));
        let (done, ended) = mpsc::sync_channel(self.shelves.len());
        let mut left = self.names();
        for shelf in &self.shelves {
            let (shelf, done) = (Arc::clone(shelf), done.clone());
            let thread = thread::Builder::new().name(format!("end-{}", shelf.config.name()));
            let ending = thread.spawn(move || {
                shelf.clear();
                // Nobody listens any more when this took too long.
                let _ = done.send(shelf.config.name().clone());
            });
            if let Err(error) = ending {
                tracing::error!(%error, "cannot start a thread to end a model");
            }
        }
        drop(done);
        while !left.is_empty() {
            let remaining = (deadline - self.clock.mono()).nanos().max(0).unsigned_abs();
            match ended.recv_timeout(Duration::from_nanos(remaining)) {
                Ok(name) => left.retain(|other| *other != name),
                Err(_) => break,
            }
        }
        if !left.is_empty() {
            self.litter.sweep();
        }
        left
    }

    fn start(&self, config: &ModelConfig) -> Result<Pool, LoadError> {
        config.check_limits()?;
        let begun = self.clock.mono();
        let model: Arc<dyn Model> = match config {
            ModelConfig::Onnx(config) => Arc::new(Onnx::load(config, &self.runtime, &self.litter)?),
            ModelConfig::Echo(config) => Arc::new(Echo::new(config.clone())),
            ModelConfig::Sleep(config) => Arc::new(Sleep::new(config.clone())),
        };
        let sizes = Sizes { workers: config.workers(), queue: config.queue() };
        Pool::start(config.name().clone(), model, sizes, &self.clock, begun)
    }
}

impl Shelf {
    /// Ends the threads of the model, if it was loaded.
    fn clear(&self) {
        let pool = self.pool.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(pool) = pool {
            pool.shutdown();
        }
    }
}

impl fmt::Debug for Bank {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Bank").field("models", &self.names()).finish_non_exhaustive()
    }
}
