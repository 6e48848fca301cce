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
    /// Chooses the folders. Without `out`, the figures of a run go to the [run's folder](separate_folders). With `out`,
    /// they go to `out`, or to a subfolder of `out` for each run if there are several runs. `named` are the paths on the
    /// command line.
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
                    runs: separate_folders(runs),
                    all_runs: current_folder_if_empty(only_folder.unwrap_or_default()),
                }
            }
        }
    }
}

fn current_folder_if_empty(path: PathBuf) -> PathBuf {
    if path == Path::new("") { PathBuf::from(".") } else { path }
}

/// Returns the folder of each run. If several files of rows are in one folder, each file without a record gets a
/// subfolder with its name, so that its figures do not replace those of another file.
fn separate_folders(runs: &[Loaded]) -> Vec<PathBuf> {
    let location = |run: &Loaded| {
        let folder = current_folder_if_empty(run.folder.clone());
        folder.canonicalize().unwrap_or(folder)
    };
    let locations: Vec<PathBuf> = runs.iter().map(location).collect();
    let mut folders: Vec<PathBuf> = Vec::new();
    for (run, location) in runs.iter().zip(&locations) {
        let is_shared = locations.iter().filter(|other| *other == location).count() > 1;
        // The format of a record that does not exist is 0.
        let folder = if is_shared && run.record.format == 0 {
            let name = Path::new(&run.record.name).file_name().unwrap_or("run".as_ref()).to_string_lossy();
            unique(&folders, |suffix| run.folder.join(format!("{name}{suffix}")))
        } else {
            run.folder.clone()
        };
        folders.push(folder);
    }
    folders
}

/// Returns the first name that is not taken: without a suffix, or with the suffix `-2`, `-3`, ….
fn unique<T: PartialEq>(taken: &[T], with_suffix: impl Fn(&str) -> T) -> T {
    let (mut name, mut number) = (with_suffix(""), 1);
    while taken.contains(&name) {
        number += 1;
        name = with_suffix(&format!("-{number}"));
    }
    name
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
        names.push(unique(&names, |suffix| format!("{name}{suffix}")));
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
    fn files_of_one_folder_have_separate_figures() {
        let run = |folder: &str, name: &str, format: u32| Loaded {
            folder: PathBuf::from(folder),
            record: RunRecord { name: name.to_owned(), format, ..RunRecord::default() },
            rows: Rows::default(),
        };
        // As of x/data.csv with its record, x/run-7.csv, x/run-7.txt, ./run-8.csv, run-9.csv and y/run-7.csv.
        let runs = [
            run("x", "edge", 1),
            run("x", "run-7", 0),
            run("x", "run-7", 0),
            run(".", "run-8", 0),
            run("", "run-9", 0),
            run("y", "run-7", 0),
        ];
        let named: Vec<PathBuf> = runs.iter().map(|run| run.folder.join("named")).collect();
        let chosen = FigureFolders::choose(&named, &runs, None);
        assert_eq!(chosen.runs, ["x", "x/run-7", "x/run-7-2", "./run-8", "run-9", "y"].map(PathBuf::from));
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
