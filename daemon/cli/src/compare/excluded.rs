//! Results that are read, but excluded from the comparison.

use std::path::Path;

use peernet_analysis::loaded::Loaded;
use peernet_analysis::run_selection::{Candidate, Exclusion, exclusions};
use peernet_statistics::number::list_first;

use super::experiment::Experiments;
use super::selected_results::is_named;

/// Reason for excluding each result, in the order of the results; `None` if a result is compared.
pub(super) struct ExclusionReasons(Vec<Option<Exclusion>>);

impl ExclusionReasons {
    /// Finds the excluded results. `named_paths` are the paths on the command line.
    ///
    /// If a run has several results, only one is compared: the first of these that exists, in this order: the
    /// baseline, a result whose path is on the command line, the result in the run's folder of the experiment, the
    /// first result.
    pub(super) fn new(
        runs: &[Loaded],
        baseline: &[usize],
        named_paths: &[&Path],
        experiments: &Experiments,
    ) -> Self {
        let candidate = |(index, run): (usize, &Loaded)| {
            let (candidate, in_experiment) = (Candidate::from_results(run), experiments.run(&run.folder));
            let is_named = named_paths.iter().any(|path| is_named(path, &run.folder, experiments));
            // The results of a baseline come first even if only a folder above them is on the command line.
            let rank = if baseline.contains(&index) {
                0
            } else {
                1 + 2 * u8::from(!is_named) + u8::from(in_experiment.is_none())
            };
            let state = in_experiment.map(|run| run.state()).or(candidate.state);
            Candidate { state, is_named, rank, ..candidate }
        };
        Self(exclusions(&runs.iter().enumerate().map(candidate).collect::<Vec<_>>()))
    }

    /// Returns whether a result is excluded.
    pub(super) fn contains(&self, run: usize) -> bool {
        self.0.get(run).is_some_and(Option::is_some)
    }

    /// Returns notes on the excluded results, one for each kind of reason.
    pub(super) fn notes(&self, runs: &[Loaded]) -> Vec<String> {
        let folder = |index: usize| runs[index].folder.display().to_string();
        let note = |kind: &str, describe: &dyn Fn(&Exclusion) -> Option<String>| {
            let descriptions: Vec<String> = (0..self.0.len())
                .filter_map(|index| {
                    Some(format!("{} ({})", folder(index), describe(self.0[index].as_ref()?)?))
                })
                .collect();
            (!descriptions.is_empty()).then(|| format!("excluded, {kind}: {}", list_first(&descriptions)))
        };
        let unfinished = note("unfinished runs", &|exclusion| match exclusion {
            Exclusion::Unfinished(_)
            | Exclusion::ConcurrentRunUnfinished(_)
            | Exclusion::EdgeMissing { .. } => Some(exclusion.describe(folder)),
            _ => None,
        });
        let copied_results =
            note("copies of other results with the same run id", &|exclusion| match exclusion {
                Exclusion::CopyOf(original) => Some(format!("of {}", folder(*original))),
                _ => None,
            });
        let measured_again = note("runs that were measured again", &|exclusion| match exclusion {
            Exclusion::MeasuredAgain(later) => Some(format!("as {}", folder(*later))),
            _ => None,
        });
        [unfinished, copied_results, measured_again].into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use serde_json::json;

    use crate::compare::{CollectedResults, collect};
    use crate::experiment::RECORD;

    const ID: &str = "285ef326-f4f1-4f29-bdd3-c62b42cfe2f4";

    fn write_run(folder: &Path, id: Option<&str>) {
        fs::create_dir_all(folder).expect("made");
        fs::write(folder.join("data.csv"), "iteration,inference,warm-up,outcome\n1,0.1,0,ok\n")
            .expect("written");
        let record = json!({ "format": 1, "run": id, "reason": "finished", "counts": { "ok": 1 } });
        fs::write(folder.join("run.json"), record.to_string()).expect("written");
    }

    fn names(found: &CollectedResults) -> Vec<&str> {
        found.runs.iter().filter_map(|run| run.folder.file_name()?.to_str()).collect()
    }

    #[test]
    fn copies_of_a_run_are_compared_once() {
        let folder = tempfile::tempdir().expect("a folder");
        let experiment_dir = folder.path().join("rates");
        let run_dir = |name: &str| experiment_dir.join("runs").join(name);
        write_run(&run_dir("007-a"), Some(ID));
        // The copy comes before the original in the order of names.
        write_run(&run_dir("000-copy"), Some(ID));
        write_run(&run_dir("008-b"), Some("94e108fc-ef56-4bf8-8876-6288987521aa"));
        for name in ["unknown-1", "unknown-2"] {
            write_run(&run_dir(name), None);
        }
        let runs = json!([{ "folder": "007-a" }, { "folder": "008-b" }]);
        let states = json!([{ "stage": "finished" }, { "stage": "finished" }]);
        let plan = json!({ "configurations": [], "runs": runs });
        let record = json!({ "format": 1, "id": "x1", "name": "rates", "states": states, "plan": plan });
        fs::write(experiment_dir.join(RECORD), record.to_string()).expect("written");

        let all = std::slice::from_ref(&experiment_dir);
        let found = collect(all, None, &|_| true).expect("they are there");
        assert_eq!(names(&found), ["007-a", "008-b", "unknown-1", "unknown-2"]);
        let [note] = found.notes.as_slice() else { panic!("{:?}", found.notes) };
        let copy = format!("{} (of {}).", run_dir("000-copy").display(), run_dir("007-a").display());
        assert!(note.starts_with("Excluded, copies of ") && note.ends_with(&copy), "{note}");

        let found = collect(all, Some(&run_dir("000-copy")), &|_| true).expect("they are there");
        assert_eq!(
            names(&found),
            ["000-copy", "008-b", "unknown-1", "unknown-2"],
            "the baseline is compared instead of the original"
        );
        assert_eq!(found.baseline, [0]);
        let baseline_dir = folder.path().join("baseline");
        write_run(&baseline_dir.join("copy"), Some(ID));
        let found = collect(&[run_dir("007-a"), run_dir("008-b")], Some(&baseline_dir), &|_| true)
            .expect("they are there");
        assert_eq!(names(&found), ["copy", "008-b"], "the baseline is in the named folder");
        assert_eq!(found.baseline, [0]);
        let found = collect(&[run_dir("008-b")], None, &|_| true).expect("it is there");
        assert!(found.notes.is_empty(), "{:?}", found.notes);
    }
}
