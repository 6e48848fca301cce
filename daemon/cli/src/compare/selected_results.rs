//! Selection among the results that were found.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::collect::is_same;
use super::experiment::{Experiment, Experiments};
use crate::experiment::{RUNS, unfinished_runs_note};

/// Results to compare: all that were found, without unfinished runs of experiments.
pub(super) struct SelectedResults {
    /// The results, each once.
    pub(super) paths: Vec<PathBuf>,
    /// Unfinished runs of each experiment.
    pub(super) unselected: Vec<UnselectedRuns>,
}

/// Notes on runs of one experiment that are not compared.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct UnselectedRuns {
    /// Sentence for the caveats of the tables: the runs and their states.
    pub(super) caveat: String,
    /// Message for the terminal: the runs, their experiment, and the command that completes these runs.
    pub(super) message: String,
}

impl SelectedResults {
    /// Selects among the results that were found at each named path. A run whose own folder is on the command line is
    /// always selected.
    pub(super) fn new(found: &[(PathBuf, Vec<PathBuf>)], experiments: &Experiments) -> Self {
        let mut paths: Vec<PathBuf> = Vec::new();
        // Experiments with a run that was found below a named path and is not itself named.
        let mut experiments_of_found_runs: BTreeMap<&Path, (&Path, &Experiment)> = BTreeMap::new();
        for (named_path, path) in
            found.iter().flat_map(|(named_path, paths)| paths.iter().map(move |path| (named_path, path)))
        {
            if let Some(run) = experiments.run(path).filter(|_| !is_named(named_path, path, experiments)) {
                experiments_of_found_runs.entry(run.experiment_dir).or_insert((named_path, run.experiment));
                if !run.state().is_finished() {
                    continue;
                }
            }
            if !paths.iter().any(|other| is_same(other, path)) {
                paths.push(path.clone());
            }
        }
        let selected_folders: Vec<PathBuf> =
            paths.iter().filter_map(|path| Some(experiments.run(path)?.folder())).collect();
        let unselected =
            experiments_of_found_runs.into_iter().filter_map(|(experiment_dir, (named_path, experiment))| {
                let is_selected =
                    |name: &str| selected_folders.contains(&experiment_dir.join(RUNS).join(name));
                let other_runs = experiment.runs().filter(|(name, _)| !is_selected(name));
                let note = unfinished_runs_note(&experiment.name, other_runs)?;
                let (named_path, command) =
                    (shorten_experiment_dir(named_path, experiment_dir), experiment.remedy());
                let message =
                    format!("{} is shown {note}; {command} completes these runs", named_path.display());
                Some(UnselectedRuns { caveat: format!("Shown {note}."), message })
            });
        Self { unselected: unselected.collect(), paths }
    }
}

/// Returns whether a path on the command line is the folder of the run that these results belong to, or is within that
/// folder. Results without an experiment have only their own folder.
pub(super) fn is_named(named_path: &Path, results: &Path, experiments: &Experiments) -> bool {
    let is_within =
        |folder: &Path| named_path.canonicalize().is_ok_and(|named_path| named_path.starts_with(folder));
    match experiments.run(results) {
        Some(run) => is_within(&run.folder()),
        None => results.canonicalize().is_ok_and(|results| is_within(&results)),
    }
}

/// Shortens the absolute path of an experiment's folder: the returned path starts with the path on the command line if
/// the experiment's folder is below that path.
fn shorten_experiment_dir(named_path: &Path, experiment_dir: &Path) -> PathBuf {
    let below = named_path
        .canonicalize()
        .ok()
        .and_then(|full| Some(experiment_dir.strip_prefix(full).ok()?.to_owned()));
    match below {
        Some(below) if below.as_os_str().is_empty() => named_path.to_owned(),
        Some(below) => named_path.join(below),
        None => experiment_dir.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use peernet_analysis::run_selection::RunState;
    use peernet_results::ResultFolder;
    use rustix::fs::{CWD, FileType, Mode, mknodat};
    use serde_json::json;

    use super::*;
    use crate::compare::{CollectedResults, collect};
    use crate::experiment::RECORD;

    /// Writes the folder of an experiment with four runs: the first is finished, and the last has not begun.
    fn write_experiment(experiment_dir: &Path) {
        let names = ["001-a", "002-a", "003-b", "004-b"];
        let runs: Vec<_> = names.iter().map(|name| json!({ "folder": name })).collect();
        let states = json!([
            { "stage": "finished", "attempts": 1 },
            { "stage": "failed", "attempts": 1, "reason": "the agent ended" },
            { "stage": "running", "attempts": 1 },
            { "stage": "pending", "attempts": 0 },
        ]);
        let plan = json!({ "configurations": [], "runs": runs });
        let mut record = json!({ "format": 1, "id": "x1", "name": "rates", "file": "e.toml" });
        (record["states"], record["plan"]) = (states, plan);
        for name in &names[..3] {
            let folder = experiment_dir.join(RUNS).join(name);
            std::fs::create_dir_all(&folder).expect("made");
            std::fs::write(folder.join("data.csv"), "iteration,inference\n1,0.1\n").expect("written");
        }
        std::fs::write(experiment_dir.join(RECORD), record.to_string()).expect("written");
    }

    fn names(found: &CollectedResults) -> Vec<String> {
        let name =
            |run: &peernet_analysis::loaded::Loaded| run.folder.file_name().map(|name| name.to_owned());
        found.runs.iter().filter_map(name).map(|name| name.to_string_lossy().into_owned()).collect()
    }

    const CAVEAT: &str = "Shown without the runs of experiment rates that are not done: 002-a (failed), \
                        003-b (in progress or killed), 004-b (to do).";

    #[test]
    fn experiment_folder_selects_finished_runs_only() {
        let folder = tempfile::tempdir().expect("a folder");
        let experiment_dir = folder.path().join("all/rates");
        write_experiment(&experiment_dir);
        // The search may begin at the experiment's folder, below it or above it.
        for place in [experiment_dir.clone(), experiment_dir.join(RUNS), folder.path().to_owned()] {
            let found = collect(&[place], None, &|_| true).expect("one is done");
            assert_eq!((names(&found), found.notes), (vec!["001-a".to_owned()], vec![CAVEAT.to_owned()]));
        }
        let unfinished = experiment_dir.join(RUNS).join("003-b");
        let found =
            collect(&[experiment_dir.clone(), unfinished.clone()], None, &|_| true).expect("two are wanted");
        assert_eq!(names(&found), ["001-a", "003-b"], "a run whose own folder is named is compared");
        assert!(!found.notes.concat().contains("003-b"), "{:?}", found.notes);
        let found =
            collect(&[unfinished.join("data.csv")], Some(&experiment_dir.join("runs/002-a")), &|_| true);
        let found = found.expect("both are named");
        assert_eq!((names(&found).len(), found.notes.len()), (2, 0));

        let found =
            collect(std::slice::from_ref(&experiment_dir), Some(&experiment_dir.join("runs/002-a")), &|_| {
                true
            });
        let found = found.expect("one is done, one is named");
        assert_eq!((names(&found), found.baseline), (vec!["002-a".to_owned(), "001-a".to_owned()], vec![0]));
        assert!(!found.notes.concat().contains("002-a"), "{:?}", found.notes);

        std::fs::remove_dir_all(experiment_dir.join("runs/001-a")).expect("removed");
        let nothing = collect(&[experiment_dir], None, &|_| true).err().expect("nothing is left");
        assert!(nothing.to_string().contains("can be compared"), "{nothing}");
    }

    #[test]
    fn runs_of_killed_experiment_count_as_on_dashboard() {
        let folder = tempfile::tempdir().expect("a folder");
        let experiment_dir = folder.path().join("rates");
        write_experiment(&experiment_dir);
        let run_dir = experiment_dir.join(RUNS).join("003-b");
        let is_compared = || {
            let found = collect(std::slice::from_ref(&experiment_dir), None, &|_| true).expect("one is done");
            assert_ne!(names(&found).contains(&"003-b".to_owned()), found.notes.concat().contains("003-b"));
            names(&found).contains(&"003-b".to_owned())
        };
        let write_record = |reason: &str, ok: u32| {
            let record = json!({ "format": 1, "reason": reason, "counts": { "ok": ok } });
            std::fs::write(run_dir.join("run.json"), record.to_string()).expect("written");
        };
        for reason in ["finished", "stopped", "the peer went away"] {
            write_record(reason, 1);
            // The aggregator receives the same reason.
            let results = ResultFolder::open(&run_dir).expect("readable");
            let state = RunState::from_end_reason(Some(&results.record.reason));
            assert_eq!(is_compared(), state.is_finished(), "{reason}");
        }
        write_record("finished", 2);
        assert!(!is_compared(), "data.csv lacks an iteration");

        write_record("finished", 1);
        let record = experiment_dir.join(RECORD);
        let text = std::fs::read_to_string(&record).expect("written");
        let two_users = r#""configurations":[{"labels":[],"users":2}]"#;
        std::fs::write(&record, text.replace(r#""configurations":[]"#, two_users)).expect("written");
        assert!(!is_compared(), "neither user has results");
    }

    #[test]
    fn unreadable_experiment_record_is_reported() {
        let folder = tempfile::tempdir().expect("a folder");
        let experiment_dir = folder.path().join("rates");
        write_experiment(&experiment_dir);
        let record = experiment_dir.join(RECORD);
        let whole = std::fs::read_to_string(&record).expect("written");
        let notes = || {
            let found =
                collect(std::slice::from_ref(&experiment_dir), None, &|_| true).expect("three can be read");
            assert_eq!(names(&found), ["001-a", "002-a", "003-b"]);
            found.notes.concat()
        };
        let truncated = &whole[..whole.len() / 2];
        let extra_state = whole
            .replace(r#"{"attempts":0,"stage":"pending"}"#, r#"{"stage":"pending"},{"stage":"pending"}"#);
        let unknown_stage = whole.replace("pending", "eaten");
        let later = whole.replace(r#""format":1"#, r#""format":2"#);
        for (text, why) in [
            ("", "EOF"),
            (truncated, "EOF"),
            ("\0", "expected value"),
            ("{}", "missing field `format`"),
            (&extra_state, "its runs, states and configurations do not fit together"),
            (&unknown_stage, "unknown variant `eaten`"),
            (&later, "its format is 2, but this program reads format 1"),
        ] {
            std::fs::write(&record, text).expect("written");
            let notes = notes();
            let beginning = format!("Cannot read {}: ", record.canonicalize().expect("there").display());
            assert!(notes.starts_with(&beginning) && notes.contains(why), "{why}: {notes}");
            assert!(notes.ends_with("; the states of its runs are unknown."), "{notes}");
        }
        std::fs::remove_file(&record).expect("removed");
        assert_eq!(notes(), "", "results without a record need no note");
        std::fs::create_dir(&record).expect("made");
        assert!(notes().contains("it is not a regular file"), "{}", notes());
        std::fs::remove_dir(&record).expect("removed");
        // No process writes into the pipe, so reading the pipe would wait for ever.
        mknodat(CWD, &record, FileType::Fifo, Mode::RUSR, 0).expect("a pipe");
        assert!(notes().contains("it is not a regular file"), "{}", notes());
    }

    #[test]
    fn excluded_runs_are_listed_with_advice() {
        let folder = tempfile::tempdir().expect("a folder");
        let experiment_dir = folder.path().join("rates");
        write_experiment(&experiment_dir);
        let found = vec![(
            folder.path().to_owned(),
            vec![experiment_dir.join("runs/001-a"), experiment_dir.join("runs/002-a")],
        )];
        let experiments = Experiments::find(found[0].1.iter().map(PathBuf::as_path));
        let [unselected] =
            SelectedResults::new(&found, &experiments).unselected.try_into().expect("one experiment");
        assert!(
            unselected.message.starts_with(&format!("{} is shown without", experiment_dir.display())),
            "{unselected:?}"
        );
        assert!(
            unselected.message.contains("; `peernet run e.toml` with the same options completes these runs"),
            "{unselected:?}"
        );
        let failed = experiments.run(&experiment_dir.join("runs/002-a/user-1"));
        assert!(failed.is_none(), "there is no such folder");
        let failed =
            experiments.run(&experiment_dir.join("runs/002-a")).expect("it is a run of the experiment");
        assert_eq!(failed.state().to_string(), "failed (the agent ended)");
    }
}
