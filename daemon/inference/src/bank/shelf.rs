//! The place of one model.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use crate::model::onnx::{CARD, MODEL};
use crate::{LoadError, ModelConfig, Pool};

/// One model on one device: the lock is held while it loads, so that it loads once and others are not held up.
pub(super) struct Shelf {
    pub(super) config: ModelConfig,
    /// What its files looked like; `None` where that does not matter.
    pub(super) stamp: Option<Stamp>,
    pool: Mutex<Option<Arc<Pool>>>,
}

impl Shelf {
    pub(super) fn new(config: ModelConfig, stamp: Option<Stamp>) -> Arc<Self> {
        Arc::new(Self { config, stamp, pool: Mutex::new(None) })
    }

    /// The model, from `start` if nobody asked before; the second is whether it was started.
    pub(super) fn pool(
        &self,
        start: impl FnOnce() -> Result<Pool, LoadError>,
    ) -> Result<(Arc<Pool>, bool), LoadError> {
        // A panic while loading leaves the shelf empty, which is a valid state.
        let mut place = self.pool.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pool) = place.as_ref() {
            return Ok((Arc::clone(pool), false));
        }
        let pool = Arc::new(start()?);
        *place = Some(Arc::clone(&pool));
        Ok((pool, true))
    }

    /// Whether nobody has the model in hand. Nobody else may hold the shelf itself.
    pub(super) fn is_idle(&self) -> bool {
        let Ok(pool) = self.pool.try_lock() else { return false };
        pool.as_ref().is_none_or(|pool| Arc::strong_count(pool) == 1)
    }

    /// Ends the threads of the model, if it was loaded. Blocks.
    pub(super) fn clear(&self) {
        let pool = self.pool.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(pool) = pool {
            pool.shutdown();
        }
    }
}

/// Size and time of change of a model's files: enough to notice that they were replaced.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Stamp([Option<(u64, SystemTime)>; 2]);

impl Stamp {
    pub(super) fn of(folder: &Path) -> Self {
        Self([MODEL, CARD].map(|file| {
            let known = std::fs::metadata(folder.join(file)).ok()?;
            Some((known.len(), known.modified().ok()?))
        }))
    }
}
