//! Results of one run that are found more than once.

use std::collections::HashMap;

use peernet_analysis::loaded::Loaded;

use super::experiment::Experiments;

/// Most copies that are named.
const MOST: usize = 8;

/// Copies among results: what was measured once counts once.
pub(super) struct Copies(Vec<Copied>);

/// Results by their places among all.
struct Copied {
    copy: usize,
    /// What stands for the run.
    kept: usize,
}

impl Copies {
    /// Finds results with the id of others. The baseline stands for its run, else what is in the folder that its
    /// experiment gave it, else what comes first.
    pub(super) fn among(runs: &[Loaded], baseline: &[usize], experiments: &Experiments) -> Self {
        let rank = |at: usize| (!baseline.contains(&at), experiments.run(&runs[at].folder).is_none(), at);
        let ids = || runs.iter().enumerate().filter_map(|(at, run)| Some((at, run.record.run?)));
        let mut kept = HashMap::new();
        for (at, id) in ids() {
            let best = kept.entry(id).or_insert(at);
            if *best != at && rank(at) < rank(*best) {
                *best = at;
            }
        }
        let copied = ids().map(|(copy, id)| Copied { copy, kept: kept[&id] });
        Self(copied.filter(|Copied { copy, kept }| copy != kept).collect())
    }

    /// Whether these are a copy.
    pub(super) fn has(&self, run: usize) -> bool {
        self.0.iter().any(|copied| copied.copy == run)
    }

    /// What is left out, if anything is.
    pub(super) fn told(&self, runs: &[Loaded]) -> Option<String> {
        let folder = |at: usize| runs[at].folder.display();
        let named = self.0.iter().take(MOST);
        let named: Vec<String> =
            named.map(|copied| format!("{} (of {})", folder(copied.copy), folder(copied.kept))).collect();
        let more = self.0.len() - named.len();
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        let named = named.join(", ");
        (!self.0.is_empty())
            .then(|| format!("left out, copies of other results by the id of their run: {named}{more}"))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use serde_json::json;

    use crate::compare::{Collected, collect};
    use crate::experiment::RECORD;

    const ID: &str = "285ef326-f4f1-4f29-bdd3-c62b42cfe2f4";

    fn run(folder: &Path, id: Option<&str>) {
        fs::create_dir_all(folder).expect("made");
        fs::write(folder.join("data.csv"), "iteration,inference,warm-up,outcome\n1,0.1,0,ok\n")
            .expect("written");
        let record = json!({ "format": 1, "run": id, "reason": "finished", "counts": { "ok": 1 } });
        fs::write(folder.join("run.json"), record.to_string()).expect("written");
    }

    fn names(found: &Collected) -> Vec<&str> {
        found.runs.iter().filter_map(|run| run.folder.file_name()?.to_str()).collect()
    }

    #[test]
    fn what_was_measured_once_counts_once() {
        let folder = tempfile::tempdir().expect("a folder");
        let home = folder.path().join("rates");
        let place = |name: &str| home.join("runs").join(name);
        run(&place("007-a"), Some(ID));
        // In front of what it is a copy of.
        run(&place("000-copy"), Some(ID));
        run(&place("008-b"), Some("94e108fc-ef56-4bf8-8876-6288987521aa"));
        for name in ["unknown-1", "unknown-2"] {
            run(&place(name), None);
        }
        let runs = json!([{ "folder": "007-a" }, { "folder": "008-b" }]);
        let states = json!([{ "stage": "finished" }, { "stage": "finished" }]);
        let plan = json!({ "configurations": [], "runs": runs });
        let record = json!({ "format": 1, "id": "x1", "name": "rates", "states": states, "plan": plan });
        fs::write(home.join(RECORD), record.to_string()).expect("written");

        let all = std::slice::from_ref(&home);
        let found = collect(all, None, &|_| true).expect("they are there");
        assert_eq!(names(&found), ["007-a", "008-b", "unknown-1", "unknown-2"]);
        let [told] = found.left_out.as_slice() else { panic!("{:?}", found.left_out) };
        let copy = format!("{} (of {}).", place("000-copy").display(), place("007-a").display());
        assert!(told.starts_with("Left out, copies of ") && told.ends_with(&copy), "{told}");

        let found = collect(all, Some(&place("000-copy")), &|_| true).expect("they are there");
        assert_eq!(names(&found), ["000-copy", "008-b", "unknown-1", "unknown-2"], "it was named");
        assert_eq!(found.baseline, [0]);
        let found = collect(&[place("008-b")], None, &|_| true).expect("it is there");
        assert!(found.left_out.is_empty(), "{:?}", found.left_out);
    }
}
