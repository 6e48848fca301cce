//! The `data.csv` in the folder of a run.

use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::LoadError;

/// Name of the file with the iterations in the folder of a run.
pub(super) const FILE_NAME: &str = "data.csv";
/// Name of the file that marks the folder of an experiment.
const EXPERIMENT_FILE: &str = "experiment.json";
/// Name of the folder in an experiment's folder that contains the folders of the runs.
const RUNS_FOLDER: &str = "runs";
/// Maximum number of runs that an error names.
const MAX_NAMED_RUNS: usize = 3;

/// Returns the file that a path names: the file itself, or `data.csv` in a folder.
///
/// # Errors
/// If the folder is that of an experiment, which has several runs, or that of a run with several users, each of whom
/// has a `data.csv`. If the runs of an experiment cannot be listed.
pub(super) fn data_file(path: &Path) -> Result<PathBuf, LoadError> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let file = path.join(FILE_NAME);
    if file.exists() {
        return Ok(file);
    }
    let is_experiment = path.join(EXPERIMENT_FILE).is_file();
    let runs = if is_experiment { runs_of_experiment(path)? } else { folders_with_data(entries(path)) };
    // A folder without runs is taken for the folder of a run. If `data.csv` is missing there, the caller fails to read
    // the file.
    if !is_experiment && runs.is_empty() {
        return Ok(file);
    }
    let advice = match runs.get(..MAX_NAMED_RUNS) {
        _ if runs.is_empty() => "it has no finished run yet; name the folder of a run".to_owned(),
        Some(first_runs) if runs.len() > MAX_NAMED_RUNS => {
            format!("name one of its {} runs, such as {}", runs.len(), first_runs.join(", "))
        }
        _ => format!("name one of its runs: {}", runs.join(", ")),
    };
    let kind_of_folder =
        if is_experiment { "an experiment" } else { "several runs, such as those of several users" };
    Err(LoadError::File {
        file: path.to_owned(),
        reason: format!("it is the folder of {kind_of_folder}, but data must name a single run; {advice}"),
    })
}

/// Returns the paths of an experiment's folders that contain a `data.csv`, sorted. A run with several users has one
/// such folder for each user.
fn runs_of_experiment(path: &Path) -> Result<Vec<String>, LoadError> {
    let folder = path.join(RUNS_FOLDER);
    let runs: Vec<PathBuf> = match fs::read_dir(&folder) {
        Ok(runs) => runs.flatten().map(|run| run.path()).collect(),
        // An experiment has this folder from its first run on.
        Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
        Err(error) => {
            let reason = format!("the runs of the experiment cannot be listed: {error}");
            return Err(LoadError::File { file: folder, reason });
        }
    };
    let users = runs.iter().flat_map(|run| entries(run)).collect::<Vec<_>>();
    Ok(folders_with_data(runs.into_iter().chain(users)))
}

/// Returns the paths of those folders that contain a `data.csv`, sorted.
fn folders_with_data(folders: impl IntoIterator<Item = PathBuf>) -> Vec<String> {
    let finished = folders.into_iter().filter(|folder| folder.join(FILE_NAME).is_file());
    let mut paths: Vec<String> = finished.map(|folder| folder.display().to_string()).collect();
    paths.sort();
    paths
}

/// Returns the paths of the entries of a folder.
fn entries(path: &Path) -> Vec<PathBuf> {
    // A folder that cannot be listed counts as empty. `data_file` then suggests no runs.
    fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_of_experiment_is_refused_with_its_runs() {
        let experiment = tempfile::tempdir().expect("a folder");
        let path = experiment.path();
        fs::write(path.join(EXPERIMENT_FILE), "{}").expect("written");
        let refusal = || data_file(path).expect_err("an experiment").to_string();
        assert!(refusal().contains("it has no finished run yet"), "{}", refusal());
        fs::write(path.join("runs"), "").expect("written");
        assert!(refusal().contains("/runs: the runs of the experiment cannot be listed"), "{}", refusal());
        fs::remove_file(path.join("runs")).expect("removed");
        for run in ["001-local-r1", "002-cloud-r1/user-1", "002-cloud-r1/user-2"] {
            fs::create_dir_all(path.join("runs").join(run)).expect("created");
            fs::write(path.join("runs").join(run).join(FILE_NAME), "inference\n").expect("written");
        }
        let run = path.join("runs/001-local-r1").display().to_string();
        assert!(
            refusal().contains("folder of an experiment") && refusal().contains(&format!("runs: {run}, "))
        );
        fs::create_dir(path.join("runs/003-cloud-r1")).expect("created");
        fs::write(path.join("runs/003-cloud-r1").join(FILE_NAME), "inference\n").expect("written");
        assert!(refusal().contains(&format!("one of its 4 runs, such as {run}, ")), "{}", refusal());
        assert!(!refusal().contains("003-cloud-r1"), "{}", refusal());
        let users = path.join("runs/002-cloud-r1");
        let text = data_file(&users).expect_err("several users").to_string();
        let first = users.join("user-1").display().to_string();
        assert!(text.contains("several users") && text.contains(&format!("its runs: {first}, ")), "{text}");
    }
}
