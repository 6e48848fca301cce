//! Check whether results are those of a run that was measured to its end.

use std::path::{Path, PathBuf};

use peernet_analysis::loaded::RowsDamage;
use peernet_analysis::record::{Counts, RunRecord};
use peernet_results::{FolderError, RECORD, ResultFolder};
use peernet_stream::EndReason;

use super::RunStatus;

/// The reason why the results of a finished run cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum UnusableResults {
    #[error("its results are missing")]
    Missing,
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error("{}: {damage}", .folder.display())]
    Damaged { folder: PathBuf, damage: RowsDamage },
    #[error("{}: {mismatch}", .folder.display())]
    Mismatched { folder: PathBuf, mismatch: Mismatch },
}

/// Reason why `run.json` does not belong to this finished run.
#[derive(Clone, Copy, Debug, thiserror::Error)]
pub(crate) enum Mismatch {
    #[error("run.json does not say that the run was finished")]
    Unfinished,
    #[error("run.json has no iteration counts")]
    NoIterations,
    #[error("run.json belongs to another run")]
    OtherRun,
}

/// Returns the folders of a run's results: the run's folder, or a folder for each user if several edges send at the
/// same time.
pub(crate) fn result_dirs(run_dir: &Path, users: u32) -> impl Iterator<Item = PathBuf> {
    (1..=users).map(move |user| match users {
        1 => run_dir.to_owned(),
        _ => run_dir.join(format!("user-{user}")),
    })
}

/// Reads the results of a run that was measured to its end, and returns their record.
///
/// # Errors
/// When the results are missing, cannot be read, are incomplete or are those of an unfinished run.
pub(crate) fn load_finished_results(folder: &Path) -> Result<RunRecord, UnusableResults> {
    if !folder.join(RECORD).is_file() {
        return Err(UnusableResults::Missing);
    }
    let results = ResultFolder::open(folder)?;
    if let Some(damage) = results.damage() {
        return Err(UnusableResults::Damaged { folder: folder.to_owned(), damage });
    }
    let mismatched = |mismatch| Err(UnusableResults::Mismatched { folder: folder.to_owned(), mismatch });
    match results.record {
        record if record.reason != EndReason::Finished => mismatched(Mismatch::Unfinished),
        record if record.counts == Counts::default() => mismatched(Mismatch::NoIterations),
        record => Ok(record),
    }
}

/// Returns the status of a run by its recorded status and its results. If a run is recorded as in progress, but its
/// results show that it was measured to its end, the returned status is [`RunStatus::Finished`]. The results decide, as
/// they do for the aggregator: the program may have been killed before it recorded the end of the run.
pub(crate) fn status_by_results(recorded: RunStatus, run_dir: &Path, users: u32) -> RunStatus {
    let is_measured = || result_dirs(run_dir, users).all(|folder| load_finished_results(&folder).is_ok());
    if recorded == RunStatus::Running && is_measured() { RunStatus::Finished } else { recorded }
}
