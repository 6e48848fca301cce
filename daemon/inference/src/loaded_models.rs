//! Number and memory of the models that are loaded.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Number and memory of the loaded models of all kinds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LoadedModels {
    /// Number of models.
    pub count: u32,
    /// Growth of this process's resident memory during the loading of a model, summed over the models, bytes; see
    /// [`Pool::memory_growth`](crate::Pool::memory_growth).
    pub memory_bytes: u64,
}

/// Counter of the loaded models and of their memory. Clones share the counter.
#[derive(Clone, Debug, Default)]
pub(crate) struct LoadedModelCounter(Arc<Mutex<LoadedModels>>);

/// Entry of one loaded model in the counter; dropping the entry removes the model from the counter.
#[derive(Debug)]
pub(crate) struct CountedModel {
    counter: LoadedModelCounter,
    memory_bytes: u64,
}

impl LoadedModelCounter {
    /// Adds a model to the counter until the returned entry is dropped.
    pub(crate) fn count(&self, memory_bytes: u64) -> CountedModel {
        let mut loaded = self.lock();
        loaded.count += 1;
        loaded.memory_bytes += memory_bytes;
        drop(loaded);
        CountedModel { counter: self.clone(), memory_bytes }
    }

    /// Returns the current number and memory of the models.
    pub(crate) fn get(&self) -> LoadedModels {
        *self.lock()
    }

    fn lock(&self) -> MutexGuard<'_, LoadedModels> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for CountedModel {
    fn drop(&mut self) {
        let mut loaded = self.counter.lock();
        loaded.count -= 1;
        loaded.memory_bytes -= self.memory_bytes;
    }
}
