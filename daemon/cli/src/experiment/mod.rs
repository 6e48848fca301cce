//! File names, states and results in an experiment's folder, for the commands that write it and that read it.

mod finished_results;
mod unfinished_runs;

pub(crate) use finished_results::{
    Mismatch, UnusableResults, load_finished_results, result_dirs, status_by_results,
};
pub(crate) use unfinished_runs::unfinished_runs_note;

use std::io::{self, ErrorKind};
use std::path::Path;

use peernet_analysis::run_selection::RunState;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::small_file;

/// Version of the format of [`RECORD`] that this program writes and reads.
pub(crate) const FORMAT: u32 = 1;

/// Name of the file with the plan and the progress of an experiment.
pub(crate) const RECORD: &str = "experiment.json";
/// Maximum size of a record that is read, bytes. A record with the maximum number of runs, each of a different
/// configuration, is smaller.
const MAX_RECORD_BYTES: u64 = 256 << 20;
/// Name of the folder in an experiment's folder that contains the folders of the runs.
pub(crate) const RUNS: &str = "runs";

/// Status of a run, as stored in [`RECORD`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum RunStatus {
    /// The run has not started.
    #[default]
    Pending,
    /// The run is in progress, or the program was killed during it.
    Running,
    /// The run was measured to its end.
    Finished,
    /// The run could not be measured, or failed before its end.
    Failed,
    /// The user stopped the run.
    Interrupted,
}

impl RunStatus {
    /// Returns the state with the reason for a failure. The state decides whether tables and figures include the run
    /// and whether the run is repeated.
    pub(crate) fn to_run_state(self, reason: Option<&str>) -> RunState {
        match self {
            Self::Pending => RunState::Pending,
            Self::Running => RunState::Open,
            Self::Finished => RunState::Finished,
            Self::Failed => RunState::Failed(reason.map(str::to_owned)),
            Self::Interrupted => RunState::Interrupted,
        }
    }

    /// Returns whether the run was measured to its end, so that it is not repeated.
    pub(crate) fn is_done(self) -> bool {
        self.to_run_state(None).is_finished()
    }

    /// Returns the name for people.
    pub(super) fn name(self) -> &'static str {
        self.to_run_state(None).name()
    }
}

/// A record of an experiment that cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RecordError {
    #[error(transparent)]
    Read(#[from] io::Error),
    #[error(transparent)]
    Parse(#[from] serde_json::Error),
    #[error("its format is {0}, but this program reads format {FORMAT}")]
    Format(u32),
    #[error("its runs, states and configurations do not fit together")]
    Inconsistent,
}

/// Reads the record in a folder, or the part of it that the type `R` has; `None` if there is no record. `is_sound`
/// checks the numbers that later code uses as indexes, because somebody may have edited the file.
///
/// # Errors
/// When the record cannot be read, has another format or is not sound.
pub(crate) fn read_record<R: DeserializeOwned>(
    experiment_dir: &Path,
    format: impl Fn(&R) -> u32,
    is_sound: impl Fn(&R) -> bool,
) -> Result<Option<R>, RecordError> {
    let text = match small_file::read_regular_file(&experiment_dir.join(RECORD), MAX_RECORD_BYTES) {
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            return Ok(None);
        }
        result => result?,
    };
    let record: R = serde_json::from_str(&text)?;
    match format(&record) {
        FORMAT if is_sound(&record) => Ok(Some(record)),
        FORMAT => Err(RecordError::Inconsistent),
        other => Err(RecordError::Format(other)),
    }
}
