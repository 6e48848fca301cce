//! Check of finished runs. A run whose results are unusable is measured again.

use std::collections::BTreeSet;
use std::path::PathBuf;

use crate::output::print_to_stderr;
use peernet_analysis::record::RunRecord;
use peernet_sample::printable_line;
use peernet_stream::ExperimentPosition;

use super::ExternalFiles;
use super::folder::Folder;
use super::plan::Run;
use super::state::Record;
use crate::experiment::{Mismatch, RunStatus, UnusableResults, load_finished_results};

/// Marks finished runs without usable results as not done. Reports external files that changed after a finished run
/// was measured.
pub(super) fn check_finished_runs(folder: &Folder, record: &mut Record, external_files: &ExternalFiles) {
    let finished = record.runs().filter(|(_, state)| state.status == RunStatus::Finished);
    let finished: Vec<Run> = finished.map(|(run, _)| run.clone()).collect();
    let mut change_notes = BTreeSet::new();
    for run in finished {
        match load_results(folder, record, &run) {
            Ok(run_records) => change_notes.extend(
                run_records.iter().filter_map(|run_record| external_files.change_note(run_record, &run)),
            ),
            Err(reason) => {
                print_to_stderr(format_args!("run {} is repeated: {reason}", run.number));
                record.reset_run(&run);
            }
        }
    }
    change_notes.iter().for_each(print_to_stderr);
}

/// Returns a note if an experiment was started by another version and runs remain.
pub(super) fn version_change_note(record: &Record, to_do: &[Run], version: &str) -> Option<String> {
    let is_continued = !to_do.is_empty() && record.count(RunStatus::Finished) > 0;
    (is_continued && record.version != version).then(|| {
        format!(
            "started by PEERNet {}, and continued by {version}: run.json of each run has the version that measured it",
            printable_line(&record.version)
        )
    })
}

/// Returns the records of a run's results, one for each user.
///
/// # Errors
/// When they are missing, cannot be read, are incomplete, or belong to another run.
pub(super) fn load_results(
    folder: &Folder,
    record: &Record,
    run: &Run,
) -> Result<Vec<RunRecord>, UnusableResults> {
    let planned = record.plan.experiment_position(run, &record.id);
    let load_user = |path: PathBuf| {
        let run_record = load_finished_results(&path)?;
        // An earlier version recorded neither index nor edges, and the labels identify the configuration.
        let ExperimentPosition { configuration_index, edges, .. } = planned;
        let recorded = run_record.experiment.clone();
        let recorded = recorded.map(|position| ExperimentPosition { configuration_index, edges, ..position });
        if recorded.as_ref() != Some(&planned) {
            return Err(UnusableResults::Mismatched { folder: path, mismatch: Mismatch::OtherRun });
        }
        Ok(run_record)
    };
    folder.results(&record.plan, run).into_iter().map(load_user).collect()
}
