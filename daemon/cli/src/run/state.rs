//! State of an experiment, as stored in `experiment.json`.

use std::path::{Component, Path};

use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use super::plan::{Plan, Run};
use crate::experiment::{FORMAT, RunStatus};

/// Record of an experiment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Record {
    /// Version of the format: [`FORMAT`].
    pub(super) format: u32,
    /// The experiment's name.
    pub(super) name: Slug,
    /// Random id of this execution, the same for all its runs.
    pub(super) id: String,
    /// Path of the file that describes the experiment.
    pub(super) file: String,
    /// Version of the program that planned the experiment.
    pub(super) version: String,
    /// States of the runs, in their order.
    pub(super) states: Vec<State>,
    /// Plan of the runs.
    pub(super) plan: Plan,
}

/// State of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct State {
    /// Status of the run.
    #[serde(rename = "stage")]
    pub(super) status: RunStatus,
    /// Number of attempts.
    pub(super) attempts: u32,
    /// Exit code of the process. If several processes measured the run, the first exit code that is not 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) exit: Option<i32>,
    /// Reason for a failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) reason: Option<String>,
    /// Seconds from the start of the run's processes to their end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) seconds: Option<f64>,
}

/// Result of a run.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RunResult {
    pub(super) status: RunStatus,
    pub(super) exit: Option<i32>,
    pub(super) reason: Option<String>,
    pub(super) seconds: f64,
}

impl Record {
    /// Makes the record of an experiment that has not started.
    pub(super) fn new(plan: Plan, id: String, file: String, version: String) -> Self {
        let states = vec![State::default(); plan.runs.len()];
        Self { format: FORMAT, name: plan.name.clone(), id, file, version, states, plan }
    }

    /// Returns whether the record can be used: each run has the number of its place, a state, a
    /// configuration of the plan and a plain folder name.
    // The folder of a run is removed before the run is measured again. A folder with a plain name
    // cannot lie outside the experiment's folder.
    pub(super) fn is_sound(&self) -> bool {
        let Plan { runs, configurations, .. } = &self.plan;
        let is_plain = |folder: &str| {
            let mut parts = Path::new(folder).components();
            matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None))
        };
        let is_valid = |(index, run): (usize, &Run)| {
            run.number == index + 1 && run.configuration < configurations.len() && is_plain(&run.folder)
        };
        self.states.len() == runs.len() && runs.iter().enumerate().all(is_valid)
    }

    /// Returns the runs with their states, in order.
    pub(super) fn runs(&self) -> impl Iterator<Item = (&Run, &State)> {
        self.plan.runs.iter().zip(&self.states)
    }

    /// Returns the selected runs that are not done, in order.
    pub(super) fn to_do(&self, is_selected: impl Fn(&Run) -> bool) -> Vec<Run> {
        let unfinished = self.runs().filter(|(run, state)| !state.status.is_done() && is_selected(run));
        unfinished.map(|(run, _)| run.clone()).collect()
    }

    /// Returns the number of runs with a status.
    pub(super) fn count(&self, status: RunStatus) -> usize {
        self.states.iter().filter(|state| state.status == status).count()
    }

    /// Records that a run begins.
    pub(super) fn start_run(&mut self, run: &Run) {
        if let Some(state) = self.state(run) {
            *state = State {
                status: RunStatus::Running,
                attempts: state.attempts.saturating_add(1),
                ..State::default()
            };
        }
    }

    /// Records the result of a run.
    pub(super) fn end_run(&mut self, run: &Run, result: RunResult) {
        if let Some(state) = self.state(run) {
            let RunResult { status, exit, reason, seconds } = result;
            *state = State { status, exit, reason, seconds: Some(seconds), ..*state };
        }
    }

    /// Marks a run without usable results as not done.
    pub(super) fn reset_run(&mut self, run: &Run) {
        if let Some(state) = self.state(run) {
            *state = State { attempts: state.attempts, ..State::default() };
        }
    }

    fn state(&mut self, run: &Run) -> Option<&mut State> {
        self.states.get_mut(run.number.checked_sub(1)?)
    }
}
