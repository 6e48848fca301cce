//! Safe replacement of earlier results: they are kept until the new results are complete.
//!
//! A run can be killed at any moment. `run.json` shows the state: it is the first file that is moved away, the last
//! file that is restored, and the last important file that a new run writes. If `run.json` is in
//! the folder of the results, the results there are complete and the moved results are obsolete.

use std::fs::{File, read_dir, remove_file, rename};
use std::io::{BufRead, BufReader, ErrorKind};
use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use crate::output::print_to_stderr;
use anyhow::Context;
use peernet_results::{DATA, RECORD, ResultFolder, remove_if_exists};
use tempfile::TempDir;

/// Prefix of the folders that contain moved results.
const PREFIX: &str = ".replaced-";
/// Beginnings of the names of files with rows of runs without results.
const ROWS_WITHOUT_RESULTS: [&str; 2] = [KILLED_ROWS, UNFINISHED_ROWS];
/// Beginning of the name of a file with the rows of a killed run.
const KILLED_ROWS: &str = "killed";
/// Beginning of the name of a file with the rows of a run whose results did not fit on the disk.
const UNFINISHED_ROWS: &str = "unfinished";

/// Results that were moved away. Dropping the guard restores the results.
#[derive(Debug)]
pub(super) struct PreviousResultsGuard {
    results_dir: PathBuf,
    /// Folder in `results_dir` with the moved results; `None` if there is nothing to restore.
    moved_results: Option<TempDir>,
}

impl PreviousResultsGuard {
    /// Moves the results of a folder away.
    ///
    /// # Errors
    /// When the results cannot be moved (exit code 73).
    pub(super) fn move_away(results_dir: &Path) -> Result<Self, Failure> {
        let mut guard = Self { results_dir: results_dir.to_owned(), moved_results: None };
        if !ResultFolder::replaced_files(results_dir).any(|name| results_dir.join(name).is_file()) {
            return Ok(guard);
        }
        // The folder is inside the results' folder, so that moving a file is a rename within one file system.
        let previous_results = tempfile::Builder::new().prefix(PREFIX).tempdir_in(results_dir);
        let previous_results = previous_results
            .with_context(|| format!("cannot write to {}", results_dir.display()))
            .map_err(unwritten)?;
        // The guard owns the folder before the first file is moved, so that a failure below restores the files that
        // were moved already.
        let previous_results = guard.moved_results.insert(previous_results).path().to_owned();
        for name in replaced_file_names(results_dir) {
            let from = results_dir.join(&name);
            rename_if_exists(&from, &previous_results.join(&name))
                .with_context(|| format!("cannot replace {}", from.display()))
                .map_err(unwritten)?;
        }
        Ok(guard)
    }

    /// Returns whether the folder contains moved results, because the run that moved them was killed or still runs.
    pub(super) fn has_leftovers(results_dir: &Path) -> bool {
        leftover_folders(results_dir).next().is_some()
    }

    /// Restores the results that a killed run had moved away, or removes them if the new results of the killed run
    /// are complete. The rows of the killed run are kept under another name. No other program may write to the folder
    /// meanwhile.
    ///
    /// # Errors
    /// When the results cannot be moved (exit code 73).
    pub(super) fn recover(results_dir: &Path) -> Result<(), Failure> {
        let mut folders: Vec<PathBuf> = leftover_folders(results_dir).collect();
        // A folder with a record has all results of a run, so it is restored rather than a folder without a record.
        folders.sort_by_key(|folder| !folder.join(RECORD).is_file());
        let Some(previous_results) = folders.first() else { return Ok(()) };
        for other in &folders[1..] {
            print_to_stderr(format_args!("other previous results are in {}", other.display()));
        }
        let failed = |error: std::io::Error| {
            let text = format!("cannot restore the results of {}", previous_results.display());
            unwritten(anyhow::Error::new(error).context(text))
        };
        // Either the killed run wrote this record, so that its results are complete, or no file was moved yet, because
        // the record is moved first.
        if results_dir.join(RECORD).is_file() {
            std::fs::remove_dir_all(previous_results).map_err(failed)?;
            print_to_stderr(format_args!(
                "a killed run had replaced the results in {}; the rest of the previous results was removed",
                results_dir.display()
            ));
            return Ok(());
        }
        // If the earlier rows were not moved yet, `data.csv` in this folder still has the earlier rows and keeps its
        // name.
        let renamed_rows = if previous_results.join(DATA).is_file() {
            rename_rows(results_dir, KILLED_ROWS).map_err(failed)?
        } else {
            None
        };
        move_back(previous_results, results_dir)
            .and_then(|()| std::fs::remove_dir_all(previous_results))
            .map_err(failed)?;
        let rows_note = renamed_rows.map_or_else(String::new, |name| format!("; its rows are in {name}"));
        print_to_stderr(format_args!(
            "a run that was to replace the results in {} was killed: the previous results are restored{rows_note}",
            results_dir.display()
        ));
        Ok(())
    }

    /// Renames the new rows, which exist nowhere else, so that they stay when the earlier results are restored.
    /// Returns the new name; `None` if there are no rows or nothing will be restored.
    pub(super) fn keep_rows(&self) -> Option<String> {
        self.moved_results.as_ref()?;
        rename_rows(&self.results_dir, UNFINISHED_ROWS).unwrap_or_else(|error| {
            print_to_stderr(format_args!("cannot rename the new data.csv: {error}"));
            None
        })
    }

    /// Removes the incomplete new results and restores the earlier ones. Returns a text to be appended to a message,
    /// which is empty if there were no earlier results.
    pub(super) fn restore(mut self) -> String {
        let Some(previous_results) = self.moved_results.take() else { return String::new() };
        // Files of the new results that have no counterpart would otherwise stay and look like a part of the restored
        // ones.
        let removed = replaced_file_names(&self.results_dir)
            .iter()
            .try_for_each(|name| remove_if_exists(&self.results_dir.join(name)));
        match removed.and_then(|()| move_back(previous_results.path(), &self.results_dir)) {
            Ok(()) => "; the previous results are restored".to_owned(),
            Err(error) => {
                format!("; the previous results are in {}: {error}", previous_results.keep().display())
            }
        }
    }

    /// Removes the earlier results, and the rows of runs without results, because the new results are complete.
    pub(super) fn remove(&mut self) {
        let removed_folder = self.moved_results.take().map_or(Ok(()), TempDir::close);
        let removed_rows = rows_without_results(&self.results_dir).into_iter().try_for_each(remove_file);
        if let Err(error) = removed_folder.and(removed_rows) {
            print_to_stderr(format_args!("cannot remove all of the replaced results: {error}"));
        }
    }
}

impl Drop for PreviousResultsGuard {
    fn drop(&mut self) {
        let Some(previous_results) = self.moved_results.take() else { return };
        if std::thread::panicking() {
            // After a panic new rows may have the names of the moved files, so nothing is moved back.
            let folder = previous_results.keep();
            return print_to_stderr(format_args!("the previous results are in {}", folder.display()));
        }
        if let Err(error) = move_back(previous_results.path(), &self.results_dir) {
            let folder = previous_results.keep();
            print_to_stderr(format_args!("the previous results are in {}: {error}", folder.display()));
        }
    }
}

fn unwritten(error: anyhow::Error) -> Failure {
    Failure::new(Exit::Unwritten, error)
}

/// Returns the folder with the earlier results, if the run that is to replace them is still active or was killed.
pub(crate) fn previous_results_folder(results_dir: &Path) -> Option<PathBuf> {
    leftover_folders(results_dir).find(|previous_results| {
        previous_results.join(RECORD).is_file() && !results_dir.join(RECORD).is_file()
    })
}

/// Returns the files with rows of runs without results.
fn rows_without_results(results_dir: &Path) -> Vec<PathBuf> {
    let has_rows_name = |path: &PathBuf| {
        let stem = path.file_name().and_then(|name| name.to_str()?.strip_suffix(".csv"));
        // The rest of the name is checked, because a file such as `killed-by-me.csv` is the user's.
        let rest = stem.and_then(|stem| ROWS_WITHOUT_RESULTS.iter().find_map(|name| stem.strip_prefix(name)));
        rest.is_some_and(|rest| {
            rest.is_empty() || rest.strip_prefix('-').is_some_and(|number| number.parse::<u32>().is_ok())
        })
    };
    let entries = read_dir(results_dir).into_iter().flatten().filter_map(Result::ok);
    entries.map(|entry| entry.path()).filter(has_rows_name).collect()
}

/// Returns the folders in `results_dir` with moved results.
fn leftover_folders(results_dir: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = read_dir(results_dir).into_iter().flatten().filter_map(Result::ok);
    let has_prefix = |name: &std::ffi::OsStr| name.to_string_lossy().starts_with(PREFIX);
    entries.filter(move |entry| has_prefix(&entry.file_name())).map(|entry| entry.path())
}

/// Returns the names of the replaced files in a folder, in the order in which they are moved away.
fn replaced_file_names(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> = ResultFolder::replaced_files(dir).collect();
    // The record is moved first: without a record the results count as incomplete from the first rename on.
    names.sort_by_key(|name| name != RECORD);
    names
}

fn move_back(kept: &Path, results_dir: &Path) -> std::io::Result<()> {
    replaced_file_names(kept)
        .iter()
        .rev()
        .try_for_each(|name| rename_if_exists(&kept.join(name), &results_dir.join(name)))
}

/// Moves a file if it exists.
pub(super) fn rename_if_exists(from: &Path, to: &Path) -> std::io::Result<()> {
    match rename(from, to) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Renames `data.csv`, if it has rows, to a free name that begins with `stem`: `killed.csv`, `killed-2.csv`. Returns
/// the new name; `None` if there are no rows.
fn rename_rows(results_dir: &Path, stem: &str) -> std::io::Result<Option<String>> {
    let data = results_dir.join(DATA);
    // The first line is the header.
    let has_rows = File::open(&data).map(|file| BufReader::new(file).lines().nth(1).is_some());
    if !has_rows.unwrap_or(false) {
        return Ok(None);
    }
    let is_free = |name: &String| !results_dir.join(name).exists();
    let numbered = (2_u32..).map(|number| format!("{stem}-{number}.csv"));
    let name = std::iter::once(format!("{stem}.csv")).chain(numbered).find(is_free);
    if let Some(name) = &name {
        rename(&data, results_dir.join(name))?;
    }
    Ok(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropped_guard_restores_results_unless_replaced() {
        let results_dir = tempfile::tempdir().expect("a folder");
        let (data, mine) = (results_dir.path().join("data.csv"), results_dir.path().join("mine.txt"));
        std::fs::write(&data, "earlier").expect("writable");
        std::fs::write(&mine, "mine").expect("writable");
        let guard = PreviousResultsGuard::move_away(results_dir.path()).expect("moved");
        assert!(!data.exists() && mine.exists());
        drop(guard);
        assert_eq!(std::fs::read_to_string(&data).expect("is back"), "earlier");

        let mut guard = PreviousResultsGuard::move_away(results_dir.path()).expect("moved");
        std::fs::write(&data, "later").expect("writable");
        guard.remove();
        drop(guard);
        assert_eq!(std::fs::read_to_string(&data).expect("is there"), "later");
        assert_eq!(
            std::fs::read_dir(results_dir.path()).expect("a folder").count(),
            2,
            "nothing is left over"
        );
    }

    #[test]
    fn unreplaced_results_are_restored_and_new_rows_kept() {
        let results_dir = tempfile::tempdir().expect("a folder");
        let read = |name: &str| std::fs::read_to_string(results_dir.path().join(name)).expect("it is there");
        for name in [DATA, RECORD] {
            std::fs::write(results_dir.path().join(name), "earlier").expect("writable");
        }
        let begin = || {
            let guard = PreviousResultsGuard::move_away(results_dir.path()).expect("moved");
            for (name, text) in [(DATA, "iteration\n1\n"), (RECORD, "{"), ("summary.md", "#")] {
                std::fs::write(results_dir.path().join(name), text).expect("writable");
            }
            guard
        };
        // Without `keep_rows`, the new rows are removed: they were written to another folder.
        assert_eq!(begin().restore(), "; the previous results are restored");
        assert_eq!(
            (names(results_dir.path()), read(DATA).as_str()),
            (vec![DATA.into(), RECORD.into()], "earlier")
        );
        let guard = begin();
        assert_eq!(guard.keep_rows().as_deref(), Some("unfinished.csv"));
        assert_eq!(guard.restore(), "; the previous results are restored");
        assert_eq!(names(results_dir.path()), [DATA, RECORD, "unfinished.csv"]);
        let texts = ["unfinished.csv", DATA, RECORD].map(read);
        assert_eq!(texts, ["iteration\n1\n", "earlier", "earlier"]);
        let empty = tempfile::tempdir().expect("a folder");
        let guard = PreviousResultsGuard::move_away(empty.path()).expect("nothing to move");
        std::fs::write(empty.path().join(DATA), "iteration\n1\n").expect("writable");
        assert_eq!((guard.keep_rows(), guard.restore()), (None, String::new()));
        assert_eq!(names(empty.path()), [DATA], "without earlier results the new rows keep their name");
    }

    /// Leaves a folder as a killed run does, which drops no guard.
    fn leave_folder_of_killed_run(results_dir: &Path, measured: &str) {
        let mut guard = PreviousResultsGuard::move_away(results_dir).expect("moved");
        let _ = guard.moved_results.take().map(TempDir::keep);
        std::fs::write(results_dir.join(DATA), measured).expect("writable");
    }

    fn names(results_dir: &Path) -> Vec<String> {
        let mut names: Vec<String> = read_dir(results_dir)
            .expect("a folder")
            .map(|entry| entry.expect("readable").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn results_moved_by_killed_run_are_restored() {
        let results_dir = tempfile::tempdir().expect("a folder");
        let read = |name: &str| std::fs::read_to_string(results_dir.path().join(name)).expect("it is there");
        for name in [DATA, RECORD] {
            std::fs::write(results_dir.path().join(name), "earlier").expect("writable");
        }
        assert!(!PreviousResultsGuard::has_leftovers(results_dir.path()));
        leave_folder_of_killed_run(results_dir.path(), "iteration\n");
        assert!(PreviousResultsGuard::has_leftovers(results_dir.path()));
        PreviousResultsGuard::recover(results_dir.path()).expect("recovered");
        assert_eq!(
            (names(results_dir.path()), read(DATA)),
            (vec![DATA.to_owned(), RECORD.to_owned()], "earlier".to_owned())
        );
        for (name, rows) in [("killed.csv", "iteration\n1\n"), ("killed-2.csv", "iteration\n1\n2")] {
            leave_folder_of_killed_run(results_dir.path(), rows);
            PreviousResultsGuard::recover(results_dir.path()).expect("recovered");
            assert_eq!((read(DATA).as_str(), read(name).as_str()), ("earlier", rows));
        }
        assert_eq!(names(results_dir.path()), [DATA, "killed-2.csv", "killed.csv", RECORD]);
        let mine = results_dir.path().join("killed-by-me.csv");
        std::fs::write(&mine, "mine").expect("writable");
        let mut guard = PreviousResultsGuard::move_away(results_dir.path()).expect("moved");
        std::fs::write(results_dir.path().join(DATA), "later").expect("writable");
        assert!(
            previous_results_folder(results_dir.path()).is_some(),
            "the earlier results are still in the folder to which they were moved"
        );
        std::fs::write(results_dir.path().join(RECORD), "later").expect("writable");
        guard.remove();
        assert_eq!(
            names(results_dir.path()),
            [DATA, "killed-by-me.csv", RECORD],
            "the new results replace everything except the user's own file"
        );
        assert_eq!(previous_results_folder(results_dir.path()), None);
    }

    #[test]
    fn run_killed_after_completion_has_replaced_results() {
        let results_dir = tempfile::tempdir().expect("a folder");
        std::fs::write(results_dir.path().join(DATA), "earlier").expect("writable");
        leave_folder_of_killed_run(results_dir.path(), "later");
        std::fs::write(results_dir.path().join(RECORD), "later").expect("writable");
        PreviousResultsGuard::recover(results_dir.path()).expect("recovered");
        assert_eq!(names(results_dir.path()), [DATA, RECORD]);
        assert_eq!(std::fs::read_to_string(results_dir.path().join(DATA)).expect("there"), "later");
    }

    #[test]
    fn run_killed_while_moving_results_loses_none() {
        let results_dir = tempfile::tempdir().expect("a folder");
        for name in [DATA, RECORD, "summary.md"] {
            std::fs::write(results_dir.path().join(name), name).expect("writable");
        }
        let kept = results_dir.path().join(format!("{PREFIX}x"));
        std::fs::create_dir(&kept).expect("made");
        for name in replaced_file_names(results_dir.path()).into_iter().take(2) {
            rename_if_exists(&results_dir.path().join(&name), &kept.join(&name)).expect("moved");
            let before = names(results_dir.path());
            PreviousResultsGuard::recover(results_dir.path()).expect("recovered");
            assert_eq!(
                names(results_dir.path()),
                [DATA, RECORD, "summary.md"],
                "after {name}, of {before:?}"
            );
            std::fs::create_dir(&kept).expect("made anew");
            // In the next pass, the killed run has moved the record and one more file.
            rename_if_exists(&results_dir.path().join(RECORD), &kept.join(RECORD)).expect("moved");
        }
    }
}
