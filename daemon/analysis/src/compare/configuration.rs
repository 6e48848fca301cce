//! Labels that distinguish runs: the first columns of a comparison.

use std::path::PathBuf;

use peernet_statistics::number::counted;

use super::columns::{self, ChosenColumns, Column};
use super::labels::{
    EMPTY_CELL, RunFacts, differ, distinguishing_pairs, experiment_columns, readable_names, tabulate,
};
use crate::loaded::Loaded;
use crate::record::RunRecord;

/// Maximum number of different labels in the joined label of a group. If there are more, the joined label is only their
/// number.
const MAX_JOINED_LABELS: usize = 3;

/// Groups the runs with equal labels. A group has the indexes of its runs, and the groups are in the order of their
/// first runs. `labels` has the labels of each run.
pub fn group_by_labels(labels: &[Vec<String>]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (run, run_labels) in labels.iter().enumerate() {
        match groups.iter_mut().find(|group| labels[group[0]] == *run_labels) {
            Some(group) => group.push(run),
            None => groups.push(vec![run]),
        }
    }
    groups
}

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
    /// Runs of one experiment are distinguished by all fields that the author of the experiment declared. Other runs
    /// are distinguished by as few columns as necessary. If these columns do not distinguish all runs, or have no label
    /// for a run, a further column names the folders or files of the runs. Repeats and edges of one configuration
    /// always have the same labels.
    pub fn from_runs(runs: &[Loaded]) -> Self {
        Self::with_other_differences(runs).0
    }

    /// Returns the [readable name](readable_names) of each configuration, with the indexes of its runs. The order of
    /// the configurations is that of their first runs.
    pub fn named_groups(&self) -> Vec<(String, Vec<usize>)> {
        let groups = group_by_labels(&self.labels);
        let names = readable_names(&self.axes, groups.iter().map(|group| self.labels[group[0]].as_slice()));
        names.into_iter().zip(groups).collect()
    }

    /// Returns the configurations, and sentences about the other differences between the runs.
    pub(super) fn with_other_differences(runs: &[Loaded]) -> (Self, Vec<String>) {
        let positions: Vec<_> = runs.iter().map(|run| run.record.experiment.as_ref()).collect();
        match experiment_columns(&positions) {
            Some(columns) => (Self::from_experiment_columns(runs, columns), Vec::new()),
            None => Self::from_records(runs),
        }
    }

    fn from_experiment_columns(runs: &[Loaded], columns: Vec<Column>) -> Self {
        let mut configurations = Self { axes: Vec::new(), labels: vec![Vec::new(); runs.len()] };
        for Column { axis, labels } in columns {
            configurations.add(&axis, labels);
        }
        if configurations.has_unrelated_duplicates(runs) {
            let groups = group_by_configuration(runs);
            let names = folder_names(runs, &groups);
            configurations.add("run", labels_by_run(runs.len(), &groups, &names));
        }
        configurations.add_pipeline_names_if_no_column(runs);
        configurations
    }

    fn from_records(runs: &[Loaded]) -> (Self, Vec<String>) {
        let groups = group_by_configuration(runs);
        let facts = runs.iter().map(|run| (run.record.experiment.as_ref(), facts_of(&run.record)));
        let pairs = distinguishing_pairs(&facts.collect::<Vec<_>>());
        let column = |Column { axis, labels: labels_of_runs }: Column| {
            let labels =
                groups.iter().map(|group| join_labels(group.iter().map(|run| &labels_of_runs[*run])));
            Column { axis, labels: labels.collect() }
        };
        let columns = tabulate(&pairs).into_iter().map(column);
        let ChosenColumns { mut columns, rest } =
            columns::choose_columns(columns.filter(Column::differs).collect());
        let is_unlabelled = |group: usize| columns.iter().all(|column| column.labels[group] == EMPTY_CELL);
        let has_unlabelled_group = (0..groups.len()).any(is_unlabelled);
        let insert_folders = |index: usize, columns: &mut Vec<Column>| {
            let column = Column { axis: "run".to_owned(), labels: folder_names(runs, &groups) };
            columns.insert(index, column);
        };
        if groups.len() > 1 {
            if has_unlabelled_group {
                // The column of folders comes first: otherwise the row of a run without labels would begin with empty
                // cells only.
                insert_folders(0, &mut columns);
            } else if !columns::distinguish_all_configurations(&columns, groups.len()) {
                insert_folders(columns.len(), &mut columns);
            }
        }
        let sentences = columns::sentences(&columns, &rest);
        let mut configurations = Self { axes: Vec::new(), labels: vec![Vec::new(); runs.len()] };
        for Column { axis, labels } in &columns {
            configurations.add(axis, labels_by_run(runs.len(), &groups, labels));
        }
        configurations.add_pipeline_names_if_no_column(runs);
        (configurations, sentences)
    }

    /// Adds a column with the names of the pipelines if there is no other column.
    fn add_pipeline_names_if_no_column(&mut self, runs: &[Loaded]) {
        if self.axes.is_empty() {
            let groups = group_by_configuration(runs);
            let names = groups.iter().map(|group| runs[group[0]].record.name.clone()).collect::<Vec<_>>();
            self.add("run", labels_by_run(runs.len(), &groups, &names));
        }
    }

    /// Adds a column. `labels` has a label for each run.
    fn add(&mut self, axis: &str, labels: Vec<String>) {
        self.axes.push(axis.to_owned());
        self.labels.iter_mut().zip(labels).for_each(|(labels_of_run, label)| labels_of_run.push(label));
    }

    /// Adds a column that distinguishes repeats.
    pub(super) fn add_repeats(&mut self, runs: &[Loaded]) {
        let repeat = |run: &Loaded| match &run.record.experiment {
            // Repeats are shown from 1.
            Some(position) => (position.repeat + 1).to_string(),
            None => EMPTY_CELL.to_owned(),
        };
        let repeats: Vec<String> = runs.iter().map(repeat).collect();
        if differ(&repeats) {
            self.add("repeat", repeats);
        }
    }

    /// Adds a column `repeats` that separates the repeats of the runs with the indexes `chosen` from the other repeats of
    /// the same configuration, so that the comparison has a line for each of these two groups. All edges of a repeat get
    /// the same label. No column is added if there are no other repeats.
    pub(super) fn separate_repeats(&mut self, runs: &[Loaded], chosen: &[usize]) {
        let repeat = |run: usize| runs[run].record.experiment.as_ref().map(|position| position.repeat);
        let label = |run: usize| {
            let chosen_with_labels = chosen.iter().filter(|other| self.labels[**other] == self.labels[run]);
            let mut repeats: Vec<Option<u32>> = chosen_with_labels.map(|other| repeat(*other)).collect();
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
        let mut same_labels = pairs.filter(|(a, b)| self.labels[*a] == self.labels[*b]);
        same_labels.any(|(a, b)| !are_repeats(&runs[a].record, &runs[b].record))
    }
}

/// Returns whether two runs measured the same configuration in the same execution of an experiment. Such runs are
/// either different repeats, or the same repeat on different edges, which measured at the same time as users of one
/// cloud.
fn are_repeats(a: &RunRecord, b: &RunRecord) -> bool {
    let have_different_edges = a.edge.name != b.edge.name;
    let (Some(a), Some(b)) = (&a.experiment, &b.experiment) else { return false };
    (&a.name, &a.id, &a.configuration) == (&b.name, &b.id, &b.configuration)
        && (a.repeat != b.repeat || have_different_edges)
}

/// Returns the facts about the configuration in the record of a run.
fn facts_of(record: &RunRecord) -> RunFacts<'_> {
    let model = record.model.as_ref();
    RunFacts {
        model: model.map(|model| model.name.as_str()),
        device: model.and_then(|model| model.device.as_deref()),
        placement: &record.placement.kind,
        network: record.placement.network.as_deref(),
        edge: &record.edge.name,
        cloud: record.cloud.as_ref().map(|cloud| cloud.name.as_str()),
        facts: &record.facts,
        pipeline: record.pipeline.get("name").and_then(|name| name.as_str()),
    }
}

/// Groups the runs by configuration. A group has the indexes of the runs of one configuration: all its repeats on all
/// edges.
fn group_by_configuration(runs: &[Loaded]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (index, run) in runs.iter().enumerate() {
        let belongs_to = |group: &&mut Vec<usize>| {
            group.iter().all(|other| are_repeats(&runs[*other].record, &run.record))
        };
        match groups.iter_mut().find(belongs_to) {
            Some(group) => group.push(index),
            None => groups.push(vec![index]),
        }
    }
    groups
}

/// Returns the label of each run, from the labels of the groups.
fn labels_by_run(run_count: usize, groups: &[Vec<usize>], group_labels: &[String]) -> Vec<String> {
    let mut run_labels = vec![EMPTY_CELL.to_owned(); run_count];
    for (group, label) in groups.iter().zip(group_labels) {
        group.iter().for_each(|run| run_labels[*run].clone_from(label));
    }
    run_labels
}

/// Joins the labels of the runs of a group into one label: `a + b`. Equal labels appear once.
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

/// Returns the name of each group: the path of its folder, without the beginning that all paths have in common. A group
/// whose file is outside of a result folder is named after the file.
fn folder_names(runs: &[Loaded], groups: &[Vec<usize>]) -> Vec<String> {
    let path = |run: &Loaded| {
        // A file of rows without a record (format 0) is a run by itself. Several such files can be in one folder, so
        // the name of the file, `record.name`, is used instead of the name of the folder. If a folder was opened
        // instead of a file, `record.name` is the name of the folder.
        let is_single_file = run.record.format == 0 && !run.folder.ends_with(&run.record.name);
        if is_single_file { run.folder.join(&run.record.name) } else { run.folder.clone() }
    };
    let parts = |run: &usize| -> Vec<String> {
        path(&runs[*run]).components().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect()
    };
    let group_path = |group: &Vec<usize>| {
        let paths: Vec<Vec<String>> = group.iter().map(parts).collect();
        let mut parts = paths[0][..common_prefix_len(&paths)].to_vec();
        if paths.len() > 1 {
            // The folder `runs` contains all runs of the experiment, so its name would distinguish nothing.
            parts.pop_if(|last| *last == "runs");
        }
        parts
    };
    let paths: Vec<Vec<String>> = groups.iter().map(group_path).collect();
    let shortest = paths.iter().map(Vec::len).min().unwrap_or_default();
    // The last part of a path is always shown, even if all paths are the same.
    let prefix_len = common_prefix_len(&paths).min(shortest.saturating_sub(1));
    paths.iter().map(|parts| parts[prefix_len..].iter().collect::<PathBuf>().display().to_string()).collect()
}

/// Returns the number of leading parts that all paths have in common.
fn common_prefix_len(paths: &[Vec<String>]) -> usize {
    let shortest = paths.iter().map(Vec::len).min().unwrap_or_default();
    (0..shortest).take_while(|index| paths.iter().all(|parts| parts[*index] == paths[0][*index])).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::Rows;

    #[test]
    fn runs_with_equal_labels_are_one_group() {
        let labels = ["a", "b", "a", "c", "b"].map(|label| vec![label.to_owned(), "x".to_owned()]);
        assert_eq!(group_by_labels(&labels), [vec![0, 2], vec![1, 4], vec![3]]);
        assert_eq!(group_by_labels(&[]), Vec::<Vec<usize>>::new());
    }

    #[test]
    fn runs_are_named_by_folders_without_common_prefix() {
        let run = |folder: &str| Loaded {
            folder: PathBuf::from(folder),
            record: RunRecord { format: 1, ..RunRecord::default() },
            rows: Rows::default(),
        };
        let labels = |folders: [&str; 2]| Configurations::from_runs(&folders.map(run)).labels.concat();
        assert_eq!(labels(["a/x", "a/y"]), ["x", "y"]);
        assert_eq!(labels(["near", "/tmp/far"]), ["near", "/tmp/far"]);
        assert_eq!(labels(["/near", "/tmp/far"]), ["near", "tmp/far"]);
    }
}
