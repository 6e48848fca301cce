//! The latest run of every pipeline.
//!
//! When the aggregator's database has lost events that it once acknowledged, the outbox sends the starts of the runs in
//! progress again.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_logger::{RunId, Slug};
use peernet_stream::{Event, RunDescription};

/// Latest run of each pipeline. Clones share the runs.
#[derive(Clone, Debug, Default)]
pub(crate) struct Runs(Arc<Mutex<BTreeMap<Slug, LatestRun>>>);

#[derive(Debug)]
struct LatestRun {
    description: RunDescription,
    is_ended: bool,
}

impl Runs {
    /// Records the start of a run, which replaces the previous run of its pipeline.
    pub(crate) fn record_start(&self, description: RunDescription) {
        self.lock().insert(description.pipeline.clone(), LatestRun { description, is_ended: false });
    }

    /// Records the end of a run of `pipeline`.
    pub(crate) fn record_end(&self, pipeline: &Slug, run: RunId) {
        if let Some(latest) = self.lock().get_mut(pipeline)
            && latest.description.run == run
        {
            latest.is_ended = true;
        }
    }

    /// Returns the run of `pipeline` that is in progress.
    pub(crate) fn current_run(&self, pipeline: &Slug) -> Option<RunId> {
        let runs = self.lock();
        runs.get(pipeline).filter(|latest| !latest.is_ended).map(|latest| latest.description.run)
    }

    /// Returns the start events of all runs in progress.
    pub(crate) fn start_events(&self) -> Vec<Event> {
        let runs = self.lock();
        let in_progress = runs.values().filter(|latest| !latest.is_ended);
        in_progress.map(|latest| Event::RunStarted(latest.description.clone())).collect()
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<Slug, LatestRun>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
