//! Access to the results of an experiment.

use std::path::{Path, PathBuf};

use peernet_tests::wait_until;
use serde_json::Value;

/// Folder of an experiment.
pub(crate) struct Results {
    pub(crate) folder: PathBuf,
}

impl Results {
    pub(crate) const fn of(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// Returns the record of the experiment.
    pub(crate) fn record(&self) -> Value {
        json(&self.folder.join("experiment.json"))
    }

    /// Returns the folders of the runs, in their order.
    pub(crate) fn folders(&self) -> Vec<String> {
        let record = self.record();
        let runs = record["plan"]["runs"].as_array().expect("a list").iter();
        runs.map(|run| run["folder"].as_str().expect("a name").to_owned()).collect()
    }

    /// Returns the states of the runs, in their order.
    pub(crate) fn states(&self) -> Vec<String> {
        let record = self.record();
        let states = record["states"].as_array().expect("a list").iter();
        states.map(|state| state["stage"].as_str().expect("a word").to_owned()).collect()
    }

    /// Returns the path of a run's file.
    pub(crate) fn file(&self, folder: &str, name: &str) -> PathBuf {
        self.folder.join("runs").join(folder).join(name)
    }

    /// Waits until the file of a run has this number of rows.
    pub(crate) fn wait_for_rows(&self, folder: &str, count: usize) {
        let path = self.file(folder, "data.csv");
        wait_until("rows", || {
            let text = std::fs::read_to_string(&path).ok()?;
            (text.lines().count() > count).then_some(())
        });
    }
}

/// Returns a column of a table of results.
pub(crate) fn column(path: &Path, name: &str) -> Vec<String> {
    let mut reader = csv::Reader::from_path(path).expect("there are rows");
    let at =
        reader.headers().expect("a header").iter().position(|column| column == name).expect("the column");
    reader.records().map(|row| row.expect("a row")[at].to_owned()).collect()
}

pub(crate) fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("it was written")).expect("it is JSON")
}
