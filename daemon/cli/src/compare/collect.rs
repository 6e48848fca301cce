//! Collection of the results to compare.

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use crate::output::print_to_stderr;
use anyhow::anyhow;
use peernet_analysis::loaded::Loaded;
use peernet_results::{DATA, FolderError, ResultFolder};
use peernet_statistics::number::counted;

use super::excluded::ExclusionReasons;
use super::experiment::Experiments;
use super::order::declared_order;
use super::selected_results::SelectedResults;
use crate::measure::previous_results_folder;

/// Results to compare, without duplicates.
pub(crate) struct CollectedResults {
    pub(crate) runs: Vec<Loaded>,
    /// Positions of the baseline in `runs`; empty without a baseline.
    pub(crate) baseline: Vec<usize>,
    /// Sentences about excluded runs (unfinished runs, copies, unreadable results), and about experiments whose
    /// records cannot be read.
    pub(crate) notes: Vec<String>,
    /// Failure with which a command ends after it has shown `runs`, because other results cannot be read. `None` if all
    /// results can be read.
    pub(crate) unreadable: Option<Failure>,
}

/// Reads all results at the named paths, except for excluded results. Only columns that `is_wanted` accepts are read.
///
/// Results keep the order of the paths, and runs of an experiment have the order of its file. A baseline comes first,
/// unless all its results are selected at the named paths already.
///
/// # Errors
/// When a path has no results or all results are excluded (exit code 66), or the baseline or all results cannot be read
/// (exit code 65).
pub(crate) fn collect(
    named_paths: &[PathBuf],
    baseline: Option<&Path>,
    is_wanted: &dyn Fn(&str) -> bool,
) -> Result<CollectedResults, Failure> {
    let results =
        distinct_paths(named_paths).into_iter().map(|path| find(&path).map(|results| (path, results)));
    let mut results: Vec<(PathBuf, Vec<PathBuf>)> = results.collect::<Result<_, Failure>>()?;
    let baseline_paths = baseline.map_or(Ok(Vec::new()), find)?;
    let all = results.iter().flat_map(|(_, results)| results).chain(&baseline_paths).map(PathBuf::as_path);
    // The experiments are found before the selection, because an experiment says which of its runs are finished.
    let experiments = Experiments::find(all);
    let mut selected = SelectedResults::new(&results, &experiments);
    // If all results of a baseline are selected at the named paths already, they keep their places.
    // Otherwise the baseline is added in front.
    let is_unselected = |path: &PathBuf| !contains_same_path(&selected.paths, path);
    if let Some(baseline) = baseline.filter(|_| baseline_paths.iter().any(is_unselected)) {
        results.insert(0, (baseline.to_owned(), baseline_paths.clone()));
        selected = SelectedResults::new(&results, &experiments);
    }
    let SelectedResults { paths, unselected } = selected;
    unselected.iter().for_each(|runs| print_to_stderr(&runs.message));
    let mut notes: Vec<String> = unselected.into_iter().map(|runs| runs.caveat).collect();
    if paths.is_empty() {
        let path_texts: Vec<String> = named_paths.iter().map(|path| path.display().to_string()).collect();
        let text = format!(
            "no results in {} can be compared; give the folder of a run to include it",
            path_texts.join(", ")
        );
        return Err(Failure::new(Exit::NoInput, anyhow!("{text}")));
    }
    // The files are read only now: unselected results may be large or damaged.
    let ReadableResults { paths, runs, failures } = read(paths, &baseline_paths, is_wanted)?;
    let unreadable = unreadable_failure(&failures, runs.len());
    notes.extend(unreadable.iter().map(|failure| to_sentence(&failure.to_string())));
    let baseline_indexes: Vec<usize> =
        (0..paths.len()).filter(|index| contains_same_path(&baseline_paths, &paths[*index])).collect();
    let command_line_paths: Vec<&Path> = named_paths.iter().map(PathBuf::as_path).chain(baseline).collect();
    // Copies of one run can be recognised only by their run ids, which are in the files.
    let exclusions = ExclusionReasons::new(&runs, &baseline_indexes, &command_line_paths, &experiments);
    let record_notes = experiments.notes_on_unreadable_records(paths.iter().map(PathBuf::as_path));
    for note in record_notes.into_iter().chain(exclusions.notes(&runs)) {
        print_to_stderr(&note);
        notes.push(to_sentence(&note));
    }
    let is_compared = |index: usize| !exclusions.contains(index);
    let compared_runs = runs.iter().enumerate().filter(|(index, _)| is_compared(*index));
    compared_runs.filter_map(|(_, run)| incompleteness_note(run, &experiments)).for_each(print_to_stderr);
    let order: Vec<usize> =
        declared_order(&runs, &experiments).into_iter().filter(|index| is_compared(*index)).collect();
    // Positions in the order of display, unlike `baseline_indexes`.
    let baseline_positions =
        (0..order.len()).filter(|index| baseline_indexes.contains(&order[*index])).collect::<Vec<_>>();
    if let Some(baseline) = baseline.filter(|_| baseline_positions.is_empty()) {
        let text = format!(
            "no run of the baseline {} is finished; give the folder of a run to include it",
            baseline.display()
        );
        return Err(Failure::new(Exit::NoInput, anyhow!("{text}")));
    }
    let mut runs: Vec<Option<Loaded>> = runs.into_iter().map(Some).collect();
    let runs = order.into_iter().filter_map(|run| runs[run].take()).collect();
    Ok(CollectedResults { runs, baseline: baseline_positions, notes, unreadable })
}

/// Results that can be read.
struct ReadableResults {
    paths: Vec<PathBuf>,
    /// The results at `paths`.
    runs: Vec<Loaded>,
    /// Reasons why other results cannot be read.
    failures: Vec<Failure>,
}

/// Reads the results at these paths.
///
/// # Errors
/// When no results can be read, or those of the baseline cannot.
fn read(
    paths: Vec<PathBuf>,
    baseline_paths: &[PathBuf],
    is_wanted: &dyn Fn(&str) -> bool,
) -> Result<ReadableResults, Failure> {
    let mut readable = ReadableResults { paths: Vec::new(), runs: Vec::new(), failures: Vec::new() };
    for path in paths {
        match open(&path, is_wanted) {
            Ok(run) => {
                readable.paths.push(path);
                readable.runs.push(run);
            }
            // Another line of the table must not silently become the baseline.
            Err(failure) if contains_same_path(baseline_paths, &path) => return Err(failure),
            Err(failure) => readable.failures.push(failure),
        }
    }
    // If no results can be read, the last failure is taken out here. The error gets the exit code of this failure.
    match readable.failures.pop_if(|_| readable.runs.is_empty()) {
        // Each result may have another reason, so the error names all reasons.
        Some(last) => {
            let exit = last.exit;
            let failures = readable.failures.into_iter().chain([last]);
            let reasons: Vec<String> = failures.map(|failure| failure.to_string()).collect();
            Err(Failure::new(exit, anyhow!("{}", reasons.join("; "))))
        }
        None => Ok(readable),
    }
}

/// Returns the failure for results that cannot be read. `readable_count` is the number of results that can be read.
fn unreadable_failure(failures: &[Failure], readable_count: usize) -> Option<Failure> {
    let reasons: Vec<String> = failures.iter().map(ToString::to_string).collect();
    (!reasons.is_empty()).then(|| {
        Failure::new(
            Exit::Data,
            anyhow!(
                "{} of {} cannot be read, so only the others are shown: {}",
                reasons.len(),
                counted((readable_count + reasons.len()) as u64, "result"),
                reasons.join("; ")
            ),
        )
    })
}

/// Turns a note into a sentence for the text below a table.
fn to_sentence(note: &str) -> String {
    let mut letters = note.chars();
    let first = letters.next().into_iter().flat_map(char::to_uppercase);
    first.chain(letters).chain(['.']).collect()
}

/// Returns a note if the results belong to an incomplete run.
fn incompleteness_note(run: &Loaded, experiments: &Experiments) -> Option<String> {
    let folder = run.folder.display();
    if let Some(damage) = run.damage() {
        return Some(format!("{folder} is incomplete: {damage}"));
    }
    if let Some(previous_results) = previous_results_folder(&run.folder) {
        return Some(format!(
            "{folder} is incomplete: a run is in progress there or was killed; the previous results are in {}, and the next run in this folder restores them if the run was killed",
            previous_results.display()
        ));
    }
    match experiments.run(&run.folder).filter(|run| !run.state().is_finished()) {
        Some(unfinished) => Some(format!(
            "{folder} belongs to an unfinished run, {}: tables and figures of its experiment exclude it; {} completes it",
            unfinished.state(),
            unfinished.experiment.remedy()
        )),
        None => Some(format!("{folder} is incomplete: {}", run.incompleteness()?)),
    }
}

/// Removes each path that leads to the same file or folder as an earlier path.
pub(crate) fn distinct_paths(paths: &[PathBuf]) -> Vec<PathBuf> {
    let mut distinct: Vec<PathBuf> = Vec::new();
    for path in paths {
        if !distinct.iter().any(|other| is_same(other, path)) {
            distinct.push(path.clone());
        }
    }
    distinct
}

/// Returns the results at or below a path.
fn find(path: &Path) -> Result<Vec<PathBuf>, Failure> {
    if path.is_file() {
        return Ok(vec![path_to_open(path).to_owned()]);
    }
    let results = ResultFolder::find(path);
    if results.is_empty() {
        let reason = match std::fs::metadata(path) {
            Ok(metadata) if metadata.is_dir() => "it contains no data.csv, at any depth".to_owned(),
            Ok(_) => "it is neither a folder nor a regular file".to_owned(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => "it does not exist".to_owned(),
            Err(error) => error.to_string(),
        };
        return Err(Failure::new(Exit::NoInput, anyhow!("no results in {}: {reason}", path.display())));
    }
    Ok(results)
}

/// Returns the path to open for a file of rows: its folder for `FOLDER/data.csv`, else the file itself.
fn path_to_open(file: &Path) -> &Path {
    match file.parent().filter(|_| file.ends_with(DATA)) {
        // An empty path is the current folder only as the beginning of a longer path.
        Some(folder) if folder == Path::new("") => Path::new("."),
        Some(folder) => folder,
        None => file,
    }
}

fn open(path: &Path, is_wanted: &dyn Fn(&str) -> bool) -> Result<Loaded, Failure> {
    ResultFolder::open_columns(path, is_wanted).map_err(|error| match error {
        FolderError::NoResults(_) => Failure::new(Exit::NoInput, error),
        _ => Failure::new(Exit::Data, error),
    })
}

/// Returns whether one of the paths leads to the same file or folder.
fn contains_same_path(paths: &[PathBuf], path: &Path) -> bool {
    paths.iter().any(|other| is_same(other, path))
}

/// Returns whether both paths lead to the same file or folder.
pub(super) fn is_same(a: &Path, b: &Path) -> bool {
    // Equal paths are compared first, because a path that does not exist has no canonical form.
    a == b || a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn path_that_is_named_twice_is_read_once() {
        let folder = tempfile::tempdir().expect("a folder");
        let run = folder.path().join("run");
        std::fs::create_dir(&run).expect("made");
        let again = folder.path().join("run/../run");
        assert_eq!(
            distinct_paths(&[run.clone(), again, folder.path().to_owned()]),
            [run, folder.path().to_owned()]
        );
    }

    #[test]
    fn baseline_can_be_named_by_data_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let runs = ["a", "b"].map(|name| folder.path().join(name));
        for run in &runs {
            std::fs::create_dir(run).expect("made");
            std::fs::write(run.join("data.csv"), "iteration,inference\n1,0.1\n").expect("written");
        }
        for baseline in [runs[1].clone(), runs[1].join("data.csv")] {
            let results = collect(&runs, Some(&baseline), &|_| true).expect("they are there");
            assert_eq!((results.runs.len(), results.baseline), (2, vec![1]), "{}", baseline.display());
        }
        let of_both = collect(&runs[..1], Some(folder.path()), &|_| true).expect("they are there");
        assert_eq!((of_both.runs.len(), of_both.baseline), (2, vec![0, 1]));
    }

    #[test]
    fn data_file_stands_for_its_folder() {
        for (file, path) in [
            ("run/data.csv", "run"),
            ("data.csv", "."),
            ("run/rows.csv", "run/rows.csv"),
            ("rows.csv", "rows.csv"),
        ] {
            assert_eq!(path_to_open(Path::new(file)), Path::new(path), "{file}");
        }
    }

    #[test]
    fn unreadable_results_are_left_out_with_reason() {
        let folder = tempfile::tempdir().expect("a folder");
        let runs = ["a", "b", "c"].map(|name| folder.path().join(name));
        let write = |run: &Path, text: &str| std::fs::write(run.join("data.csv"), text).expect("written");
        for run in &runs {
            std::fs::create_dir(run).expect("made");
            write(run, "iteration,inference\n1,0.1\n");
        }
        write(&runs[1], "iteration,inference\n1,a,b,c\n2,d\n");
        let results = collect(&runs, Some(&runs[2]), &|_| true).expect("two can be read");
        let failure = results.unreadable.expect("one cannot");
        let text = failure.to_string();
        assert!(failure.exit == Exit::Data && text.contains("1 of 3 results"), "{text}");
        assert!(text.contains(&runs[1].join("data.csv").display().to_string()), "{text}");
        let folders: Vec<_> = results.runs.iter().map(|run| run.folder.clone()).collect();
        assert_eq!((folders, results.baseline), (vec![runs[0].clone(), runs[2].clone()], vec![1]));
        assert!(results.notes.concat().contains("1 of 3 results"), "{:?}", results.notes);

        assert_eq!(
            collect(&runs, Some(&runs[1]), &|_| true).err().map(|failure| failure.exit),
            Some(Exit::Data)
        );
        let only = collect(&runs[1..2], None, &|_| true).err().expect("nothing is left");
        assert!(only.exit == Exit::Data && only.to_string().contains("data.csv"), "{only}");
    }

    #[test]
    fn path_without_results_is_reported_with_reason() {
        let reason = |path: &str| find(Path::new(path)).expect_err("no results").to_string();
        assert!(reason("/dev/null").ends_with("it is neither a folder nor a regular file"));
        assert!(reason("/nowhere").ends_with("it does not exist"));
    }

    #[test]
    fn incomplete_results_are_reported() {
        let folder = tempfile::tempdir().expect("a folder");
        let data = folder.path().join("data.csv");
        std::fs::write(&data, "iteration,inference,warm-up,outcome\n1,0.1,0,ok\n").expect("written");
        let note = || {
            let run = open(folder.path(), &|_| true).expect("readable");
            incompleteness_note(&run, &Experiments::find(std::iter::once(folder.path())))
        };
        assert!(note().is_some_and(|text| text.contains("in progress or was killed")), "{:?}", note());
        let record = |reason: &str| {
            let text = format!(
                r#"{{"format":1,"reason":"{reason}","pipeline":{{"limit":{{"total":9}}}},"counts":{{"ok":1}}}}"#
            );
            std::fs::write(folder.path().join("run.json"), text).expect("written");
        };
        record("stopped");
        assert!(
            note().is_some_and(|text| text.ends_with("interrupted after 1 of 9 iterations")),
            "{:?}",
            note()
        );
        record("finished");
        assert_eq!(note(), None);
    }
}
