//! The last run of every pipeline, for whoever has to tell of it once more.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_logger::{RunId, Slug};
use peernet_stream::{Event, RunDescription};

/// Runs by pipeline; clones are the same.
#[derive(Clone, Debug, Default)]
pub(crate) struct Runs(Arc<Mutex<BTreeMap<Slug, Known>>>);

#[derive(Debug)]
struct Known {
    description: RunDescription,
    ended: bool,
}

impl Runs {
    /// A run began; the last one of its pipeline is forgotten.
    pub(crate) fn began(&self, description: RunDescription) {
        self.lock().insert(description.pipeline.clone(), Known { description, ended: false });
    }

    /// A run of `pipeline` ended.
    pub(crate) fn ended(&self, pipeline: &Slug, run: RunId) {
        if let Some(known) = self.lock().get_mut(pipeline)
            && known.description.run == run
        {
            known.ended = true;
        }
    }

    /// The run of `pipeline` that is under way.
    pub(crate) fn current(&self, pipeline: &Slug) -> Option<RunId> {
        let runs = self.lock();
        runs.get(pipeline).filter(|known| !known.ended).map(|known| known.description.run)
    }

    /// The beginnings of all runs under way.
    pub(crate) fn beginnings(&self) -> Vec<Event> {
        let runs = self.lock();
        let open = runs.values().filter(|known| !known.ended);
        open.map(|known| Event::RunStarted(known.description.clone())).collect()
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<Slug, Known>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
