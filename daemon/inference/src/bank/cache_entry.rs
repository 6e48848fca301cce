//! Cache entry of one model.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::time::SystemTime;

use crate::model::onnx;
use crate::{LoadError, ModelConfig, Pool};

/// One model on one device. Each entry has its own lock, which is held while the model loads: the model is loaded
/// only once, and other models are not delayed.
pub(super) struct CacheEntry {
    pub(super) config: ModelConfig,
    /// State of the model's files when the entry was created; `None` if changes of the files are ignored.
    pub(super) stamp: Option<FilesStamp>,
    pool: Mutex<Option<Arc<Pool>>>,
}

impl CacheEntry {
    pub(super) fn new(config: ModelConfig, stamp: Option<FilesStamp>) -> Arc<Self> {
        Arc::new(Self { config, stamp, pool: Mutex::new(None) })
    }

    /// Returns the pool, and whether this call started it with `start`.
    pub(super) fn pool(
        &self,
        start: impl FnOnce() -> Result<Pool, LoadError>,
    ) -> Result<(Arc<Pool>, bool), LoadError> {
        // A panic during loading leaves the entry empty, which is a valid state.
        let mut slot = self.pool.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pool) = slot.as_ref() {
            return Ok((Arc::clone(pool), false));
        }
        let pool = Arc::new(start()?);
        *slot = Some(Arc::clone(&pool));
        Ok((pool, true))
    }

    /// Returns whether the pool is not in use. The caller must make sure that no other thread gets the pool from this
    /// entry meanwhile.
    pub(super) fn is_idle(&self) -> bool {
        let pool = match self.pool.try_lock() {
            Ok(pool) => pool,
            // A panic during loading leaves the entry in a valid state.
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            // Another thread holds the lock while it loads the model.
            Err(TryLockError::WouldBlock) => return false,
        };
        // Whoever uses the pool holds a reference to the pool, and only drops this reference at the end of the use.
        pool.as_ref().is_none_or(|pool| Arc::strong_count(pool) == 1)
    }

    /// Takes the pool out of the entry; `None` if the model is not loaded.
    pub(super) fn take(&self) -> Option<Arc<Pool>> {
        self.pool.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// Sizes and modification times of a model's files. If two stamps differ, a file was replaced.
// The stamp is read for each request. A hash of a large model's files would take too long.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct FilesStamp(Vec<Option<(u64, SystemTime)>>);

impl FilesStamp {
    /// Reads the sizes and modification times of a model's files.
    pub(super) fn read(folder: &Path) -> Self {
        let mut files = onnx::model_files(folder).unwrap_or_default();
        files.push(folder.join(onnx::CARD));
        let stamp = |file: &PathBuf| {
            let metadata = file.metadata().ok()?;
            Some((metadata.len(), metadata.modified().ok()?))
        };
        Self(files.iter().map(stamp).collect())
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;

    #[test]
    fn entry_is_idle_after_panic_during_loading() {
        let entry = CacheEntry::new(ModelConfig::echo("echo".parse().expect("a name")), None);
        let loading = catch_unwind(AssertUnwindSafe(|| entry.pool(|| panic!("as planned")).is_ok()));
        assert!(loading.is_err());
        assert!(entry.is_idle(), "the entry can be removed to make room for another model");
    }
}
