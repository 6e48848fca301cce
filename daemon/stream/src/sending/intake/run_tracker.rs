//! Tracking of the runs whose events are submitted.

use std::collections::BTreeMap;

use peernet_logger::{RunId, Slug};

use crate::{Event, MAX_COUNTED_RUNS};

/// Active runs with their pipelines, and ended runs that are still counted separately.
#[derive(Clone, Debug, Default)]
pub(super) struct RunTracker {
    /// Pipelines of the active runs. They are needed because an iteration names its run but not its pipeline.
    pipelines: BTreeMap<RunId, Slug>,
    /// Ended runs that are still counted separately.
    ended_runs: Vec<RunId>,
}

impl RunTracker {
    /// Records the start and the end of runs.
    pub(super) fn observe(&mut self, event: &Event) {
        match event {
            Event::RunStarted(started) => {
                if self.pipelines.len() >= MAX_COUNTED_RUNS {
                    // The ids are random, so an arbitrary run is forgotten. Its later losses have no pipeline.
                    self.pipelines.pop_first();
                }
                self.pipelines.insert(started.run, started.pipeline.clone());
            }
            Event::RunEnded(ended) => {
                self.pipelines.remove(&ended.run);
                if self.ended_runs.len() < MAX_COUNTED_RUNS {
                    self.ended_runs.push(ended.run);
                }
            }
            _ => {}
        }
    }

    /// Returns the pipeline and the run that an event concerns.
    pub(super) fn scope(&self, event: &Event) -> (Option<Slug>, Option<RunId>) {
        let run_scope = |run: &RunId| (self.pipelines.get(run).cloned(), Some(*run));
        match event {
            Event::RunStarted(started) => (Some(started.pipeline.clone()), Some(started.run)),
            Event::RunEnded(ended) => run_scope(&ended.run),
            Event::Iteration(iteration) => run_scope(&iteration.run),
            Event::Incident(incident) => (incident.pipeline.clone(), incident.run),
            Event::Gap(gap) => (gap.pipeline.clone(), gap.run),
            Event::Clock(_) => (None, None),
        }
    }

    /// Returns the ended runs that are still counted separately.
    pub(super) fn ended_runs(&self) -> &[RunId] {
        &self.ended_runs
    }

    /// Removes an ended run that is no longer counted separately.
    pub(super) fn forget(&mut self, run: RunId) {
        self.ended_runs.retain(|ended| *ended != run);
    }
}
