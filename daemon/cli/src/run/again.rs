//! Runs that are finished by the record, and are to be done again all the same.

use std::collections::BTreeSet;
use std::path::PathBuf;

use crate::output::complain;
use crate::short::plain;
use peernet_report::record::{Counts, RunRecord};
use peernet_results::ResultFolder;

use super::Beside;
use super::folder::Folder;
use super::plan::Run;
use super::state::Record;
use crate::experiment::Stage;

/// What was taken away is to be done again; what was measured with another file of devices is told.
pub(super) fn settle(folder: &Folder, record: &mut Record, beside: &Beside) {
    let finished = record.runs().filter(|(_, state)| state.stage == Stage::Finished);
    let finished: Vec<Run> = finished.map(|(run, _)| run.clone()).collect();
    let mut changed = BTreeSet::new();
    for run in finished {
        match found(folder, record, &run) {
            Ok(told) => changed.extend(told.iter().filter_map(|told| beside.changed_since(told, &run))),
            Err(why) => {
                complain(format_args!("run {} is done again: {why}", run.number));
                record.forget(&run);
            }
        }
    }
    changed.iter().for_each(complain);
}

/// A sentence when an experiment that this build has not begun is gone on with.
pub(super) fn two_builds(record: &Record, to_do: &[Run], version: &str) -> Option<String> {
    let goes_on = !to_do.is_empty() && record.count(Stage::Finished) > 0;
    (goes_on && record.version != version).then(|| {
        format!(
            "begun by PEERNet {}, and gone on with by {version}: run.json of each run has the version that measured it",
            plain(&record.version)
        )
    })
}

/// What a run's results say of themselves, for each user.
///
/// # Errors
/// Why they cannot be used: they are gone, cannot be read, are not whole, or are those of another run.
pub(super) fn found(folder: &Folder, record: &Record, run: &Run) -> Result<Vec<RunRecord>, String> {
    let of_user = |path: &PathBuf| {
        if !path.join("run.json").is_file() {
            return Err("its results are gone".to_owned());
        }
        let loaded = ResultFolder::open(path).map_err(|error| error.to_string())?;
        let why = loaded.damage().or_else(|| lacks(&loaded.record, record, run).map(str::to_owned));
        why.map_or(Ok(loaded.record), |why| Err(format!("{}: {why}", path.display())))
    };
    folder.results(&record.plan, run).iter().map(of_user).collect()
}

/// What a finished run says of itself, and this one does not.
fn lacks(told: &RunRecord, record: &Record, run: &Run) -> Option<&'static str> {
    if told.reason != "finished" {
        return Some("run.json does not say that the run was finished");
    }
    if told.counts == Counts::default() {
        return Some("run.json counts no iterations");
    }
    let place = record.plan.place(run, &record.id);
    (told.experiment.as_ref() != Some(&place)).then_some("run.json is that of another run")
}
