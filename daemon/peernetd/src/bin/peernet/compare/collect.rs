//! The runs that are compared.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use peernet_report::results::{FolderError, Loaded, ResultFolder};
use peernetd::exit::{Exit, Failure};
use peernetd::output::complain;

use super::order::as_declared;
use crate::measure::put_aside;

/// Runs, each once.
pub(crate) struct Collected {
    pub(crate) runs: Vec<Loaded>,
    /// Which of them is the baseline, if one was named.
    pub(crate) baseline: Option<usize>,
}

/// Reads the columns that are wanted of all results in the places, in their order; the runs of an experiment in that of its
/// file. A baseline that is not among them comes first.
///
/// # Errors
/// When a place holds no results (66) or some cannot be read (65).
pub(crate) fn collect(
    places: &[PathBuf],
    baseline: Option<&Path>,
    wanted: &dyn Fn(&str) -> bool,
) -> Result<Collected, Failure> {
    let mut paths: Vec<PathBuf> = Vec::new();
    for found in distinct(places).iter().map(|place| find(place)) {
        for path in found? {
            if !paths.iter().any(|other| is_same(other, &path)) {
                paths.push(path);
            }
        }
    }
    let baseline = baseline.map(|path| {
        let path = if path.is_file() { folder_of(path) } else { path };
        paths.iter().position(|other| is_same(other, path)).unwrap_or_else(|| {
            paths.insert(0, path.to_owned());
            0
        })
    });
    let runs = paths.iter().map(|path| open(path, wanted)).collect::<Result<Vec<Loaded>, Failure>>()?;
    for run in &runs {
        if let Some(damage) = run.damage() {
            complain(format_args!("{} is not whole: {damage}", run.folder.display()));
        }
        if let Some(kept) = put_aside(&run.folder) {
            complain(format_args!(
                "{} is not whole: a run is under way there or was killed; the earlier results are in {} and come back with the next run there, if it was killed",
                run.folder.display(),
                kept.display()
            ));
        }
    }
    let order = as_declared(&runs);
    let baseline = baseline.and_then(|baseline| order.iter().position(|run| *run == baseline));
    let mut runs: Vec<Option<Loaded>> = runs.into_iter().map(Some).collect();
    Ok(Collected { runs: order.into_iter().filter_map(|run| runs[run].take()).collect(), baseline })
}

/// The places, each once.
pub(crate) fn distinct(places: &[PathBuf]) -> Vec<PathBuf> {
    let mut once: Vec<PathBuf> = Vec::new();
    for place in places {
        if !once.iter().any(|other| is_same(other, place)) {
            once.push(place.clone());
        }
    }
    once
}

fn find(place: &Path) -> Result<Vec<PathBuf>, Failure> {
    if place.is_file() {
        return Ok(vec![folder_of(place).to_owned()]);
    }
    let found = ResultFolder::find(place);
    if found.is_empty() {
        let what = if place.is_dir() { "there is no data.csv in it or below" } else { "it is not there" };
        return Err(Failure::new(Exit::NoInput, anyhow!("no results in {}: {what}", place.display())));
    }
    Ok(found)
}

/// What a file of rows is opened as: that of a folder of results is the folder.
fn folder_of(file: &Path) -> &Path {
    let folder = file.parent().filter(|folder| file.ends_with("data.csv") && *folder != Path::new(""));
    folder.unwrap_or(file)
}

fn open(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Loaded, Failure> {
    ResultFolder::open_columns(path, wanted).map_err(|error| match error {
        FolderError::NoResults(_) => Failure::new(Exit::NoInput, error),
        _ => Failure::new(Exit::Data, error),
    })
}

/// Whether both lead to one place, however they are written.
fn is_same(a: &Path, b: &Path) -> bool {
    a == b || a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_that_is_named_twice_counts_once() {
        let folder = tempfile::tempdir().expect("a folder");
        let run = folder.path().join("run");
        std::fs::create_dir(&run).expect("made");
        let again = folder.path().join("run/../run");
        assert_eq!(
            distinct(&[run.clone(), again, folder.path().to_owned()]),
            [run, folder.path().to_owned()]
        );
    }

    #[test]
    fn a_baseline_may_be_named_by_its_file_of_rows() {
        let folder = tempfile::tempdir().expect("a folder");
        let runs = ["a", "b"].map(|name| folder.path().join(name));
        for run in &runs {
            std::fs::create_dir(run).expect("made");
            std::fs::write(run.join("data.csv"), "iteration,inference\n1,0.1\n").expect("written");
        }
        for baseline in [runs[1].clone(), runs[1].join("data.csv")] {
            let found = collect(&runs, Some(&baseline), &|_| true).expect("they are there");
            assert_eq!((found.runs.len(), found.baseline), (2, Some(1)), "{}", baseline.display());
        }
    }
}
