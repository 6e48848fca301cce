//! Folders for figures.

use std::path::{Path, PathBuf};

use peernet_analysis::loaded::Loaded;

/// Folders for the figures.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct FigureFolders {
    /// Folder for the figures of each run.
    pub(super) runs: Vec<PathBuf>,
    /// Folder for the figures that show all runs.
    pub(super) all_runs: PathBuf,
}

impl FigureFolders {
    /// Chooses the folders. Without `out`, the figures of a run go to the run's folder. With `out`, they go to `out`,
    /// or to a subfolder of `out` for each run if there are several runs. `named` are the paths on the command line.
    pub(super) fn choose(named: &[PathBuf], runs: &[Loaded], out: Option<&Path>) -> Self {
        let folders = || runs.iter().map(|run| run.folder.clone());
        match (out, named) {
            (Some(out), _) if runs.len() == 1 => {
                Self { runs: vec![out.to_owned()], all_runs: out.to_owned() }
            }
            (Some(out), _) => Self {
                runs: subfolder_names(&folders().collect::<Vec<_>>())
                    .iter()
                    .map(|name| out.join(name))
                    .collect(),
                all_runs: out.to_owned(),
            },
            (None, [folder]) if folder.is_dir() => {
                Self { runs: folders().collect(), all_runs: folder.clone() }
            }
            (None, _) => {
                // All figures of a single run, such as one data.csv, go to the folder of the run. Figures that show
                // several runs go to the current folder, because the command line has several paths.
                let only_folder = if runs.len() == 1 { folders().next() } else { None };
                Self {
                    runs: folders().collect(),
                    all_runs: current_folder_if_empty(only_folder.unwrap_or_default()),
                }
            }
        }
    }
}

fn current_folder_if_empty(path: PathBuf) -> PathBuf {
    if path == Path::new("") { PathBuf::from(".") } else { path }
}

/// Returns a name for each folder: its path without the common beginning. The names are unique.
fn subfolder_names(folders: &[PathBuf]) -> Vec<String> {
    let parts = |folder: &PathBuf| -> Vec<String> {
        let parts = folder.components().map(|part| part.as_os_str().to_string_lossy().into_owned());
        parts.filter(|part| part != "." && part != ".." && part != "/").collect()
    };
    let all: Vec<Vec<String>> = folders.iter().map(parts).collect();
    let shortest = all.iter().map(Vec::len).min().unwrap_or_default();
    let common =
        (0..shortest).take_while(|index| all.iter().all(|parts| parts[*index] == all[0][*index])).count();
    // The last part of each path stays, so that no name is empty.
    let common = common.min(shortest.saturating_sub(1));
    let mut names: Vec<String> = Vec::new();
    for parts in &all {
        let name = if parts.is_empty() { "run".to_owned() } else { parts[common..].join("-") };
        let (mut unique_name, mut number) = (name.clone(), 1);
        while names.contains(&unique_name) {
            number += 1;
            unique_name = format!("{name}-{number}");
        }
        names.push(unique_name);
    }
    names
}

#[cfg(test)]
mod tests {
    use peernet_analysis::record::RunRecord;
    use peernet_analysis::rows::Rows;

    use super::*;

    fn folders(named: &[&str], runs: &[&str], out: Option<&str>) -> (Vec<String>, String) {
        let loaded = |folder: &&str| Loaded {
            folder: PathBuf::from(*folder),
            record: RunRecord::default(),
            rows: Rows::default(),
        };
        let named: Vec<PathBuf> = named.iter().map(PathBuf::from).collect();
        let runs: Vec<Loaded> = runs.iter().map(loaded).collect();
        let FigureFolders { runs, all_runs } = FigureFolders::choose(&named, &runs, out.map(Path::new));
        (runs.iter().map(|path| path.display().to_string()).collect(), all_runs.display().to_string())
    }

    #[test]
    fn figures_are_written_to_result_folders() {
        let runs = |folders: &[&str]| folders.iter().map(|folder| (*folder).to_owned()).collect::<Vec<_>>();
        assert_eq!(
            folders(&["/tmp"], &["/tmp/a", "/tmp/b"], None),
            (runs(&["/tmp/a", "/tmp/b"]), "/tmp".into())
        );
        assert_eq!(folders(&["x/a", "x/b"], &["x/a", "x/b"], None), (runs(&["x/a", "x/b"]), ".".into()));
        assert_eq!(folders(&["x/a/data.csv"], &["x/a"], None), (runs(&["x/a"]), "x/a".into()));
    }

    #[test]
    fn given_folder_has_subfolder_per_run() {
        let runs = |folders: &[&str]| folders.iter().map(|folder| (*folder).to_owned()).collect::<Vec<_>>();
        assert_eq!(folders(&["x"], &["x/a"], Some("out")), (runs(&["out"]), "out".into()));
        let several = folders(&["x"], &["x/m/a", "x/n/a"], Some("out"));
        assert_eq!(several, (runs(&["out/m-a", "out/n-a"]), "out".into()));
        let alike = folders(&["p", "q"], &["../a", "./a"], Some("out"));
        assert_eq!(alike, (runs(&["out/a", "out/a-2"]), "out".into()));
    }
}
