//! Labels that distinguish runs: the first columns of a comparison.

use std::path::PathBuf;

use peernet_statistics::number::counted;

use super::columns::{self, ChosenColumns, Column};
use crate::loaded::Loaded;
use crate::record::RunRecord;

/// Cell of a run that has no such fact.
pub(super) const EMPTY_CELL: &str = "—";
/// Facts that follow from a run's model or data set, which has a column already.
const IMPLIED_FACTS: [&str; 6] = ["model", "device", "task", "input", "labels", "classes"];
/// Maximum number of labels of one group that are written side by side.
const MAX_JOINED_LABELS: usize = 3;

/// Configurations of runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Configurations {
    /// Names of the columns that distinguish the runs.
    pub axes: Vec<String>,
    /// Labels of each run: as many as there are axes.
    pub labels: Vec<Vec<String>>,
}

impl Configurations {
    /// Returns the configurations of runs.
    ///
    /// Runs of one experiment are distinguished by all of its fields, as the experiment's author declared them. Other runs have as few
    /// columns as are needed to distinguish them. Runs that are alike, or of which nothing is known, are named after their folders or
    /// files. Repeats and edges of one configuration always have the same labels.
    pub fn from_runs(runs: &[Loaded]) -> Self {
        Self::with_other_differences(runs).0
    }

    /// Returns the configurations, and sentences about their other differences.
    pub(super) fn with_other_differences(runs: &[Loaded]) -> (Self, Vec<String>) {
        let places: Vec<Vec<(String, String)>> =
            runs.iter().map(|run| declared_labels(&run.record)).collect();
        let names =
            |place: &Vec<(String, String)>| place.iter().map(|(axis, _)| axis.clone()).collect::<Vec<_>>();
        let same_axes = places.windows(2).all(|pair| names(&pair[0]) == names(&pair[1]));
        if same_axes && runs.iter().all(|run| run.record.experiment.is_some()) {
            (Self::from_experiment_fields(runs, &places), Vec::new())
        } else {
            Self::from_records(runs, &places)
        }
    }

    fn from_experiment_fields(runs: &[Loaded], places: &[Vec<(String, String)>]) -> Self {
        let mut this = Self::tabulate(places);
        let executions = executions(runs);
        if differ(&executions) {
            this.add("execution", executions);
        }
        if this.has_unrelated_duplicates(runs) {
            let groups = groups(runs);
            let names = folders(runs, &groups);
            this.add("run", labels_by_run(runs.len(), &groups, &names));
        }
        this.add_names_if_unlabelled(runs);
        this
    }

    fn from_records(runs: &[Loaded], places: &[Vec<(String, String)>]) -> (Self, Vec<String>) {
        let groups = groups(runs);
        let pairs = runs.iter().zip(places).zip(executions(runs)).map(|((run, place), execution)| {
            [place.clone(), vec![("execution".to_owned(), execution)], detected_labels(&run.record)].concat()
        });
        let all = Self::tabulate(&pairs.collect::<Vec<_>>());
        let column = |(at, axis): (usize, String)| {
            let labels =
                groups.iter().map(|group| join_labels(group.iter().map(|run| &all.labels[*run][at])));
            Column { axis, labels: labels.collect() }
        };
        let columns = all.axes.iter().cloned().enumerate().map(column);
        let ChosenColumns { mut columns, rest } =
            columns::choose_columns(columns.filter(|column| differ(&column.labels)).collect());
        let nameless = |group: usize| columns.iter().all(|column| column.labels[group] == EMPTY_CELL);
        let named = (0..groups.len()).all(|group| !nameless(group));
        let name = |place: usize, columns: &mut Vec<Column>| {
            let column = Column { axis: "run".to_owned(), labels: folders(runs, &groups) };
            columns.insert(place, column);
        };
        if groups.len() > 1 {
            if !named {
                name(0, &mut columns);
            } else if !columns::are_distinct(&columns, groups.len()) {
                name(columns.len(), &mut columns);
            }
        }
        let sentences = columns::sentences(&columns, &rest);
        let mut this = Self { axes: Vec::new(), labels: vec![Vec::new(); runs.len()] };
        for Column { axis, labels } in &columns {
            this.add(axis, labels_by_run(runs.len(), &groups, labels));
        }
        this.add_names_if_unlabelled(runs);
        (this, sentences)
    }

    fn add_names_if_unlabelled(&mut self, runs: &[Loaded]) {
        if self.axes.is_empty() {
            let groups = groups(runs);
            let names = groups.iter().map(|group| runs[group[0]].record.name.clone()).collect::<Vec<_>>();
            self.add("run", labels_by_run(runs.len(), &groups, &names));
        }
    }

    /// Returns all names in the order of their first appearance, with the label of each run. The field `Model` of an experiment and the
    /// `model` of a run outside of experiments are the same column.
    fn tabulate(pairs: &[Vec<(String, String)>]) -> Self {
        let mut axes: Vec<String> = Vec::new();
        for (axis, _) in pairs.iter().flatten() {
            if !axes.iter().any(|other| other.eq_ignore_ascii_case(axis)) {
                axes.push(axis.clone());
            }
        }
        let label = |pairs: &Vec<(String, String)>, axis: &String| {
            let found = pairs
                .iter()
                .find(|(name, _)| name.eq_ignore_ascii_case(axis))
                .map(|(_, label)| label.clone());
            found.filter(|label| !label.is_empty()).unwrap_or_else(|| EMPTY_CELL.to_owned())
        };
        let labels = pairs.iter().map(|pairs| axes.iter().map(|axis| label(pairs, axis)).collect()).collect();
        Self { axes, labels }
    }

    fn add(&mut self, axis: &str, labels: Vec<String>) {
        self.axes.push(axis.to_owned());
        self.labels.iter_mut().zip(labels).for_each(|(all, label)| all.push(label));
    }

    /// Adds a column that distinguishes repeats.
    pub(super) fn add_repeats(&mut self, runs: &[Loaded]) {
        let repeat = |run: &Loaded| match &run.record.experiment {
            // Repeats are shown from 1.
            Some(place) => (place.repeat + 1).to_string(),
            None => EMPTY_CELL.to_owned(),
        };
        let repeats: Vec<String> = runs.iter().map(repeat).collect();
        if differ(&repeats) {
            self.add("repeat", repeats);
        }
    }

    /// Gives each of the chosen runs a separate line, next to the other repeats of its configuration. Edges that were measured at the same
    /// time stay together.
    pub(super) fn separate_runs(&mut self, runs: &[Loaded], chosen: &[usize]) {
        let repeat = |run: usize| runs[run].record.experiment.as_ref().map(|place| place.repeat);
        let label = |run: usize| {
            let siblings = chosen.iter().filter(|other| self.labels[**other] == self.labels[run]);
            let mut repeats: Vec<Option<u32>> = siblings.map(|other| repeat(*other)).collect();
            repeats.sort();
            repeats.dedup();
            match (repeats.contains(&repeat(run)), repeats.as_slice()) {
                (_, []) => EMPTY_CELL.to_owned(),
                (false, _) => "the other repeats".to_owned(),
                // Repeats are shown from 1.
                (true, [Some(repeat)]) => format!("repeat {}", repeat + 1),
                (true, repeats) => counted(repeats.len() as u64, "repeat"),
            }
        };
        let labels: Vec<String> = (0..runs.len()).map(label).collect();
        if labels.iter().any(|label| label == "the other repeats") {
            self.add("repeats", labels);
        }
    }

    /// Returns whether two runs have the same labels without being declared repeats of each other.
    fn has_unrelated_duplicates(&self, runs: &[Loaded]) -> bool {
        let pairs = (0..runs.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
        let mut alike = pairs.filter(|(a, b)| self.labels[*a] == self.labels[*b]);
        alike.any(|(a, b)| !are_repeats(&runs[a].record, &runs[b].record))
    }
}

/// Returns whether two runs are repeats of one configuration of one execution of an experiment, or two edges that were measured at the same
/// time, as users of one cloud.
fn are_repeats(a: &RunRecord, b: &RunRecord) -> bool {
    let edges = a.edge.name != b.edge.name;
    let (Some(a), Some(b)) = (&a.experiment, &b.experiment) else { return false };
    (&a.name, &a.id, &a.configuration) == (&b.name, &b.id, &b.configuration)
        && (a.repeat != b.repeat || edges)
}

/// Returns the fields of a run's experiment.
fn declared_labels(record: &RunRecord) -> Vec<(String, String)> {
    record.experiment.as_ref().map(|place| place.configuration.clone()).unwrap_or_default()
}

/// Returns the facts in a run's record about its configuration, the paper's columns first.
fn detected_labels(record: &RunRecord) -> Vec<(String, String)> {
    let pair = |axis: &str, label: Option<&str>| (axis.to_owned(), label.unwrap_or_default().to_owned());
    let model = record.model.as_ref();
    let mut pairs = vec![
        pair("model", model.map(|model| model.name.as_str())),
        pair("device", model.and_then(|model| model.device.as_deref())),
        pair("where", Some(&record.placement.kind)),
        pair("network", record.placement.network.as_deref()),
        pair("edge", Some(&record.edge.name)),
        pair("cloud", record.cloud.as_ref().map(|cloud| cloud.name.as_str())),
    ];
    let implied = |fact: &str| IMPLIED_FACTS.iter().any(|name| name.eq_ignore_ascii_case(fact));
    pairs.extend(record.facts.iter().filter(|(fact, _)| !implied(fact)).cloned());
    pairs
}

/// Returns the experiment and its execution that each run belongs to.
fn executions(runs: &[Loaded]) -> Vec<String> {
    let experiments = || runs.iter().map(|run| run.record.experiment.as_ref());
    let names: Vec<String> =
        experiments().map(|place| place.map_or(EMPTY_CELL, |place| &place.name).to_owned()).collect();
    if differ(&names) {
        return names;
    }
    let short = |id: &str| id.chars().take(8).collect::<String>();
    experiments().map(|place| place.map_or_else(|| EMPTY_CELL.to_owned(), |place| short(&place.id))).collect()
}

/// Returns the runs as groups of repeats and edges of one configuration.
fn groups(runs: &[Loaded]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (at, run) in runs.iter().enumerate() {
        let belongs = |group: &&mut Vec<usize>| {
            group.iter().all(|other| are_repeats(&runs[*other].record, &run.record))
        };
        match groups.iter_mut().find(belongs) {
            Some(group) => group.push(at),
            None => groups.push(vec![at]),
        }
    }
    groups
}

/// Returns the label of each run, from the labels of the groups.
fn labels_by_run(runs: usize, groups: &[Vec<usize>], labels: &[String]) -> Vec<String> {
    let mut all = vec![EMPTY_CELL.to_owned(); runs];
    for (group, label) in groups.iter().zip(labels) {
        group.iter().for_each(|run| all[*run].clone_from(label));
    }
    all
}

/// Returns the labels of the runs of a group as one label.
fn join_labels<'a>(labels: impl Iterator<Item = &'a String>) -> String {
    let mut distinct: Vec<&str> = Vec::new();
    for label in labels {
        if !distinct.contains(&label.as_str()) {
            distinct.push(label);
        }
    }
    if distinct.len() > MAX_JOINED_LABELS {
        return format!("{} different", distinct.len());
    }
    distinct.join(" + ")
}

/// Returns the names of the groups: their folders, or their files if these are outside of a result folder, without the common prefix.
fn folders(runs: &[Loaded], groups: &[Vec<usize>]) -> Vec<String> {
    let path = |run: &Loaded| {
        // A file of rows without a record is named after itself.
        let alone = run.record.format == 0 && !run.folder.ends_with(&run.record.name);
        if alone { run.folder.join(&run.record.name) } else { run.folder.clone() }
    };
    let parts = |run: &usize| -> Vec<String> {
        path(&runs[*run]).components().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect()
    };
    let of_group = |group: &Vec<usize>| {
        let paths: Vec<Vec<String>> = group.iter().map(parts).collect();
        let mut parts = paths[0][..common_prefix_len(&paths)].to_vec();
        if paths.len() > 1 {
            parts.pop_if(|last| *last == "runs");
        }
        parts
    };
    let all: Vec<Vec<String>> = groups.iter().map(of_group).collect();
    let shortest = all.iter().map(Vec::len).min().unwrap_or_default();
    // The last part of a path is always shown.
    let front = common_prefix_len(&all).min(shortest.saturating_sub(1));
    all.iter().map(|parts| parts[front..].iter().collect::<PathBuf>().display().to_string()).collect()
}

/// Returns the number of leading parts that all paths have in common.
fn common_prefix_len(paths: &[Vec<String>]) -> usize {
    let shortest = paths.iter().map(Vec::len).min().unwrap_or_default();
    (0..shortest).take_while(|at| paths.iter().all(|parts| parts[*at] == paths[0][*at])).count()
}

pub(super) fn differ(labels: &[String]) -> bool {
    labels.windows(2).any(|pair| pair[0] != pair[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::Rows;

    #[test]
    fn runs_are_named_by_folders_without_common_prefix() {
        let run = |folder: &str| Loaded {
            folder: PathBuf::from(folder),
            record: RunRecord { format: 1, ..RunRecord::default() },
            rows: Rows::default(),
        };
        let named = |folders: [&str; 2]| Configurations::from_runs(&folders.map(run)).labels.concat();
        assert_eq!(named(["a/x", "a/y"]), ["x", "y"]);
        assert_eq!(named(["near", "/tmp/far"]), ["near", "/tmp/far"]);
        assert_eq!(named(["/near", "/tmp/far"]), ["near", "tmp/far"]);
    }
}
