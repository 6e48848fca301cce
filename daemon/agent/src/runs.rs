//! The latest run of every pipeline.
//!
//! After a welcome by a database that lacks what it once stored, the outbox repeats the starts of the runs in
//! progress.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_logger::{RunId, Slug};
use peernet_stream::{Event, RunDescription};

/// Runs by pipeline; clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Runs(Arc<Mutex<BTreeMap<Slug, LatestRun>>>);

#[derive(Debug)]
struct LatestRun {
    description: RunDescription,
    ended: bool,
}

impl Runs {
    /// Records that a run began, in place of the pipeline's previous one.
    pub(crate) fn began(&self, description: RunDescription) {
        self.lock().insert(description.pipeline.clone(), LatestRun { description, ended: false });
    }

    /// Records that a run of `pipeline` ended.
    pub(crate) fn ended(&self, pipeline: &Slug, run: RunId) {
        if let Some(latest) = self.lock().get_mut(pipeline)
            && latest.description.run == run
        {
            latest.ended = true;
        }
    }

    /// Returns the run of `pipeline` that is in progress.
    pub(crate) fn current(&self, pipeline: &Slug) -> Option<RunId> {
        let runs = self.lock();
        runs.get(pipeline).filter(|latest| !latest.ended).map(|latest| latest.description.run)
    }

    /// Returns the start events of all runs in progress.
    pub(crate) fn run_starts(&self) -> Vec<Event> {
        let runs = self.lock();
        let open = runs.values().filter(|latest| !latest.ended);
        open.map(|latest| Event::RunStarted(latest.description.clone())).collect()
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<Slug, LatestRun>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
