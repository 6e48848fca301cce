//! The `data.csv` in the folder of a run.

use std::fs;
use std::path::{Path, PathBuf};

use crate::LoadError;

/// Name of the file in a folder of results.
pub(super) const FILE_NAME: &str = "data.csv";
/// File in the folder of an experiment, and its folder with the folders of the runs.
const EXPERIMENT_FILE: &str = "experiment.json";
const RUNS_FOLDER: &str = "runs";
/// Maximum number of runs that an error names.
const MAX_NAMED_RUNS: usize = 3;

/// Returns the file that a path names: the file itself, or `data.csv` in a folder.
///
/// # Errors
/// If the folder is that of an experiment, which has several runs, or that of several users, who have a `data.csv`
/// each.
pub(super) fn data_file(path: &Path) -> Result<PathBuf, LoadError> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let file = path.join(FILE_NAME);
    let is_experiment = path.join(EXPERIMENT_FILE).is_file();
    let runs = if is_experiment { runs_of_experiment(path) } else { folders_with_data(folders(path)) };
    if file.exists() || !is_experiment && runs.is_empty() {
        return Ok(file);
    }
    let advice = match runs.get(..MAX_NAMED_RUNS) {
        _ if runs.is_empty() => "it has no finished run yet; name the folder of a run".to_owned(),
        Some(first) if runs.len() > MAX_NAMED_RUNS => {
            format!("name one of its {} runs, such as {}", runs.len(), first.join(", "))
        }
        _ => format!("name one of its runs: {}", runs.join(", ")),
    };
    let whole = if is_experiment { "an experiment" } else { "several runs, such as those of several users" };
    Err(LoadError::File {
        file: path.to_owned(),
        reason: format!("it is the folder of {whole}, and data is one run; {advice}"),
    })
}

/// Returns the folders with a `data.csv` of an experiment, sorted. A run with several users has a folder for each.
fn runs_of_experiment(path: &Path) -> Vec<String> {
    let runs = folders(&path.join(RUNS_FOLDER));
    let users = runs.iter().flat_map(|run| folders(run)).collect::<Vec<_>>();
    folders_with_data(runs.into_iter().chain(users))
}

/// Returns the names of those folders that have a `data.csv`, sorted.
fn folders_with_data(folders: impl IntoIterator<Item = PathBuf>) -> Vec<String> {
    let finished = folders.into_iter().filter(|folder| folder.join(FILE_NAME).is_file());
    let mut names: Vec<String> = finished.map(|folder| folder.display().to_string()).collect();
    names.sort();
    names
}

/// Returns the paths of the entries of a folder.
fn folders(path: &Path) -> Vec<PathBuf> {
    // A folder that cannot be listed has no runs to name; the error about the path remains.
    fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_of_an_experiment_is_refused_with_its_runs() {
        let experiment = tempfile::tempdir().expect("a folder");
        let path = experiment.path();
        fs::write(path.join(EXPERIMENT_FILE), "{}").expect("written");
        let refused = || data_file(path).expect_err("an experiment").to_string();
        assert!(refused().contains("it has no finished run yet"), "{}", refused());
        for run in ["001-local-r1", "002-cloud-r1/user-1", "002-cloud-r1/user-2"] {
            fs::create_dir_all(path.join("runs").join(run)).expect("created");
            fs::write(path.join("runs").join(run).join(FILE_NAME), "inference\n").expect("written");
        }
        let run = path.join("runs/001-local-r1").display().to_string();
        assert!(
            refused().contains("folder of an experiment") && refused().contains(&format!("runs: {run}, "))
        );
        fs::create_dir(path.join("runs/003-cloud-r1")).expect("created");
        fs::write(path.join("runs/003-cloud-r1").join(FILE_NAME), "inference\n").expect("written");
        assert!(refused().contains(&format!("one of its 4 runs, such as {run}, ")), "{}", refused());
        assert!(!refused().contains("003-cloud-r1"), "{}", refused());
        let users = path.join("runs/002-cloud-r1");
        let text = data_file(&users).expect_err("several users").to_string();
        let first = users.join("user-1").display().to_string();
        assert!(text.contains("several users") && text.contains(&format!("its runs: {first}, ")), "{text}");
    }
}
