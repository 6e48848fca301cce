//! How far an experiment is: what `experiment.json` holds.

use std::path::{Component, Path};

use peernet_logger::Slug;
use serde::{Deserialize, Serialize};

use super::plan::{Plan, Run};
use crate::experiment::{FORMAT, Stage};

/// The whole of an experiment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Record {
    /// [`FORMAT`].
    pub(super) format: u32,
    /// The experiment's name.
    pub(super) name: Slug,
    /// Of this execution, random: all its runs have it.
    pub(super) id: String,
    /// The file that it was read from.
    pub(super) file: String,
    /// Version of the program that planned it.
    pub(super) version: String,
    /// How the runs fare, in their order.
    pub(super) states: Vec<State>,
    /// What is measured, in which order.
    pub(super) plan: Plan,
}

/// How a run fares.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct State {
    /// What became of it.
    pub(super) stage: Stage,
    /// How often it was begun.
    pub(super) attempts: u32,
    /// Exit code of the process; of several the first that is not 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) exit: Option<i32>,
    /// Why it is not as it should be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) reason: Option<String>,
    /// How long it took from the start of its process to its end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) seconds: Option<f64>,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ended {
    pub(super) stage: Stage,
    pub(super) exit: Option<i32>,
    pub(super) reason: Option<String>,
    pub(super) seconds: f64,
}

impl Record {
    /// Nothing is done yet.
    pub(super) fn new(plan: Plan, id: String, file: String, version: String) -> Self {
        let states = vec![State::default(); plan.runs.len()];
        Self { format: FORMAT, name: plan.name.clone(), id, file, version, states, plan }
    }

    /// Whether each run has its state, its configuration and a folder of its own: what is removed for it is no other.
    pub(super) fn is_sound(&self) -> bool {
        let Plan { runs, configurations, .. } = &self.plan;
        let is_plain = |folder: &str| {
            let mut parts = Path::new(folder).components();
            matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None))
        };
        let is_sound = |(at, run): (usize, &Run)| {
            run.number == at + 1 && run.configuration < configurations.len() && is_plain(&run.folder)
        };
        self.states.len() == runs.len() && runs.iter().enumerate().all(is_sound)
    }

    /// The runs with their states, in order.
    pub(super) fn runs(&self) -> impl Iterator<Item = (&Run, &State)> {
        self.plan.runs.iter().zip(&self.states)
    }

    /// The runs that are to be done, in order; those before `from` and those that nobody wants are passed over.
    pub(super) fn to_do(&self, wanted: impl Fn(&Run) -> bool) -> Vec<Run> {
        let open = self.runs().filter(|(run, state)| !state.stage.is_done() && wanted(run));
        open.map(|(run, _)| run.clone()).collect()
    }

    /// How many runs are at a stage.
    pub(super) fn count(&self, stage: Stage) -> usize {
        self.states.iter().filter(|state| state.stage == stage).count()
    }

    /// A run begins.
    pub(super) fn begin(&mut self, run: &Run) {
        if let Some(state) = self.state(run) {
            *state = State {
                stage: Stage::Running,
                attempts: state.attempts.saturating_add(1),
                ..State::default()
            };
        }
    }

    /// It ended.
    pub(super) fn end(&mut self, run: &Run, ended: Ended) {
        if let Some(state) = self.state(run) {
            let Ended { stage, exit, reason, seconds } = ended;
            *state = State { stage, exit, reason, seconds: Some(seconds), ..*state };
        }
    }

    /// Its results are there no longer.
    pub(super) fn forget(&mut self, run: &Run) {
        if let Some(state) = self.state(run) {
            *state = State { attempts: state.attempts, ..State::default() };
        }
    }

    fn state(&mut self, run: &Run) -> Option<&mut State> {
        self.states.get_mut(run.number.checked_sub(1)?)
    }
}
