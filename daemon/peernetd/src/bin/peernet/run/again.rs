//! Runs that are finished by the record, and are to be done again all the same.

use std::path::PathBuf;

use peernet_report::results::{Counts, ResultFolder, RunRecord};
use peernetd::output::complain;

use super::folder::Folder;
use super::plan::Run;
use super::state::{Record, Stage};

/// What was taken away is to be done again.
pub(super) fn settle(folder: &Folder, record: &mut Record) {
    let finished = record.runs().filter(|(_, state)| state.stage == Stage::Finished);
    let damaged = |(run, _): (&Run, _)| Some((run.clone(), damage(folder, record, run)?));
    let damaged: Vec<(Run, String)> = finished.filter_map(damaged).collect();
    for (run, why) in damaged {
        complain(format_args!("run {} is done again: {why}", run.number));
        record.forget(&run);
    }
}

/// Why a run's results cannot be used: they are gone, cannot be read, are not whole, or are those of another run.
pub(super) fn damage(folder: &Folder, record: &Record, run: &Run) -> Option<String> {
    let of_user = |path: &PathBuf| {
        if !path.join("run.json").is_file() {
            return Some("its results are gone".to_owned());
        }
        match ResultFolder::open(path) {
            Ok(loaded) => {
                let why = loaded.damage().or_else(|| lacks(&loaded.record, record, run).map(str::to_owned));
                why.map(|why| format!("{}: {why}", path.display()))
            }
            Err(error) => Some(error.to_string()),
        }
    };
    folder.results(&record.plan, run).iter().find_map(of_user)
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
