//! Experiments that results belong to.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use peernet_analysis::run_selection::RunState;
use peernet_sample::printable_line;
use serde::Deserialize;

use crate::experiment::{RECORD, RUNS, RecordError, RunStatus, read_record, status_by_results};

/// Number of parent folders of results that are searched for the record of their experiment. Between the results and
/// the experiment's folder are `runs`, the run's folder if several edges send at the same time, and possibly a folder
/// that the user made.
const MAX_ANCESTORS: usize = 4;

/// Experiments by their folders, or the error of reading their records. Runs without a readable record are compared
/// like other results.
pub(super) struct Experiments(BTreeMap<PathBuf, Result<Experiment, RecordError>>);

/// Part of `experiment.json` that a comparison needs.
#[derive(Deserialize)]
pub(super) struct Experiment {
    format: u32,
    pub(super) id: String,
    #[serde(default)]
    pub(super) name: String,
    /// Path of the experiment's file, as it was typed.
    #[serde(default)]
    file: String,
    /// States of the runs, in their order.
    #[serde(default)]
    states: Vec<RecordedState>,
    pub(super) plan: Plan,
}

#[derive(Deserialize)]
pub(super) struct Plan {
    pub(super) configurations: Vec<Configuration>,
    #[serde(default)]
    runs: Vec<Run>,
}

#[derive(Deserialize)]
pub(super) struct Configuration {
    pub(super) labels: Vec<(String, String)>,
    /// Number of edges that send at the same time; `None` stands for 1.
    users: Option<u32>,
}

#[derive(Deserialize)]
struct Run {
    folder: String,
    /// Index of the run's configuration in the plan.
    #[serde(default)]
    configuration: usize,
}

#[derive(Deserialize)]
struct RecordedState {
    #[serde(rename = "stage")]
    status: RunStatus,
    reason: Option<String>,
}

/// A run of an experiment.
#[derive(Clone, Copy)]
pub(super) struct ExperimentRun<'a> {
    /// Folder of the experiment.
    pub(super) experiment_dir: &'a Path,
    pub(super) experiment: &'a Experiment,
    run: &'a Run,
    state: &'a RecordedState,
}

impl Experiments {
    /// Finds the experiments of these results.
    pub(super) fn find<'a>(results: impl Iterator<Item = &'a Path>) -> Self {
        let mut records = BTreeMap::new();
        for folder in results.flat_map(ancestor_folders) {
            records.entry(folder).or_insert_with_key(|folder| self::read(folder));
        }
        Self(records.into_iter().filter_map(|(folder, record)| Some((folder, record.transpose()?))).collect())
    }

    /// Returns a note on each experiment of these results whose record cannot be read.
    pub(super) fn notes_on_unreadable_records<'a>(
        &self,
        results: impl Iterator<Item = &'a Path>,
    ) -> Vec<String> {
        let results: Vec<PathBuf> = results.filter_map(|path| path.canonicalize().ok()).collect();
        let unreadable = self
            .0
            .iter()
            .filter_map(|(experiment_dir, record)| Some((experiment_dir, record.as_ref().err()?)));
        let has_runs =
            |experiment_dir: &Path| results.iter().any(|path| path.starts_with(experiment_dir.join(RUNS)));
        unreadable
            .filter(|(experiment_dir, _)| has_runs(experiment_dir))
            .map(|(experiment_dir, error)| {
                let (record, reason) = (experiment_dir.join(RECORD), error.to_string());
                let reason = printable_line(&reason);
                format!("cannot read {}: {reason}; the states of its runs are unknown", record.display())
            })
            .collect()
    }

    /// Returns the experiment to which results belong, if its record has this id.
    pub(super) fn experiment_with_id(&self, results: &Path, id: &str) -> Option<&Experiment> {
        let experiment_in = |folder: &PathBuf| self.0.get(folder)?.as_ref().ok();
        ancestor_folders(results).iter().filter_map(experiment_in).find(|experiment| experiment.id == id)
    }

    /// Returns the run to which results belong, by their path.
    pub(super) fn run(&self, results: &Path) -> Option<ExperimentRun<'_>> {
        let path = results.canonicalize().ok()?;
        ancestor_folders(results).iter().find_map(|folder| {
            let (experiment_dir, record) = self.0.get_key_value(folder)?;
            let experiment = record.as_ref().ok()?;
            let name = path.strip_prefix(experiment_dir.join(RUNS)).ok()?.iter().next()?;
            let index = experiment.plan.runs.iter().position(|run| *run.folder == *name)?;
            let (run, state) = (&experiment.plan.runs[index], experiment.states.get(index)?);
            Some(ExperimentRun { experiment_dir, experiment, run, state })
        })
    }
}

impl Experiment {
    /// Returns the folders of the runs and their status.
    pub(super) fn runs(&self) -> impl Iterator<Item = (&str, RunStatus)> {
        self.plan.runs.iter().zip(&self.states).map(|(run, state)| (&*run.folder, state.status))
    }

    /// Returns the command that completes the runs of the experiment.
    pub(super) fn remedy(&self) -> String {
        format!("`peernet run {}` with the same options", printable_line(&self.file))
    }
}

impl ExperimentRun<'_> {
    /// Returns the folder of the run.
    pub(super) fn folder(&self) -> PathBuf {
        self.experiment_dir.join(RUNS).join(&self.run.folder)
    }

    /// Returns the state of the run.
    pub(super) fn state(&self) -> RunState {
        let RecordedState { status, reason } = self.state;
        status.to_run_state(reason.as_deref().map(printable_line).as_deref())
    }
}

/// Returns the parent folders of results that may be the folder of their experiment.
fn ancestor_folders(results: &Path) -> Vec<PathBuf> {
    let folder = results.canonicalize().unwrap_or_default();
    folder.ancestors().skip(1).take(MAX_ANCESTORS).map(Path::to_owned).collect()
}

/// Reads the record of the experiment in a folder; `None` if it does not exist.
///
/// # Errors
/// When the file cannot be read or is not a record.
fn read(experiment_dir: &Path) -> Result<Option<Experiment>, RecordError> {
    let is_sound = |experiment: &Experiment| experiment.plan.runs.len() == experiment.states.len();
    let mut experiment = read_record(experiment_dir, |experiment: &Experiment| experiment.format, is_sound)?;
    if let Some(Experiment { plan, states, .. }) = &mut experiment {
        for (run, state) in plan.runs.iter().zip(states) {
            let users =
                plan.configurations.get(run.configuration).and_then(|configuration| configuration.users);
            let run_dir = experiment_dir.join(RUNS).join(&run.folder);
            state.status = status_by_results(state.status, &run_dir, users.unwrap_or(1));
        }
    }
    Ok(experiment)
}
