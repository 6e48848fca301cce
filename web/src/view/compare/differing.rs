//! Settings in which the runs of a comparison differ.

use peernet_analysis::compare::{
    ChosenColumns, Column, RunFacts, choose_columns, choose_further_columns, distinguishing_pairs,
    experiment_columns, tabulate,
};
use peernet_logger::Slug;
use peernet_store::RunDetail;
use peernet_stream::{ExperimentPosition, PlacementKind};

/// Settings that distinguish runs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct DifferingSettings {
    /// Names of the settings that identify a configuration.
    pub(super) axes: Vec<String>,
    /// For each run its value on each axis.
    pub(super) axis_values: Vec<Vec<String>>,
    /// Further settings that differ, and declared settings of an experiment that are equal for all
    /// runs. Each has a value per run.
    pub(super) other_settings: Vec<Column>,
    /// Names of further settings that differ, but whose values are too long for a table, such as
    /// hashes, paths and lists.
    pub(super) names_of_long_settings: Vec<String>,
}

impl DifferingSettings {
    /// Returns the axes of the experiment's file.
    pub(super) fn of_experiment(runs: &[RunDetail]) -> Self {
        let all = experiment_columns(&positions(runs)).unwrap_or_default();
        // If no axis differs, the experiment has a single configuration. All axes are shown then,
        // because the declared values identify this configuration.
        let any_axis_differs = all.iter().any(Column::differs);
        let (columns, settings) = all.into_iter().partition(|column| !any_axis_differs || column.differs());
        Self::from_columns(runs.len(), ChosenColumns { columns, rest: settings })
    }

    /// Returns the columns by which `peernet compare` distinguishes the runs. For runs of one experiment these are the
    /// fields in which the runs differ, and further facts if runs have equal fields, such as the edges of one run. For
    /// other runs these are the fewest facts that distinguish them.
    pub(super) fn of_runs(runs: &[RunDetail]) -> Self {
        let facts = runs.iter().map(|run| (run.summary.experiment.as_ref(), run_facts(run)));
        let all = tabulate(&distinguishing_pairs(&facts.collect::<Vec<_>>()));
        let differing = all.into_iter().filter(Column::differs).collect::<Vec<_>>();
        let chosen = match experiment_columns(&positions(runs)) {
            Some(columns) => {
                let fields = columns.into_iter().filter(Column::differs).collect::<Vec<_>>();
                let others = differing.into_iter().filter(|column| !fields.contains(column)).collect();
                choose_further_columns(fields, others)
            }
            None => choose_columns(differing),
        };
        Self::from_columns(runs.len(), chosen)
    }

    fn from_columns(runs: usize, ChosenColumns { columns, rest }: ChosenColumns) -> Self {
        let (long_settings, other_settings): (Vec<Column>, Vec<Column>) =
            rest.into_iter().partition(Column::is_opaque);
        let row = |run: usize| columns.iter().map(|column| column.labels[run].clone()).collect();
        Self {
            axis_values: (0..runs).map(row).collect(),
            axes: columns.iter().map(|column| column.axis.clone()).collect(),
            other_settings,
            names_of_long_settings: long_settings.into_iter().map(|column| column.axis).collect(),
        }
    }
}

/// Returns the position of each run in its experiment; `None` for a run without an experiment.
fn positions(runs: &[RunDetail]) -> Vec<Option<&ExperimentPosition>> {
    runs.iter().map(|run| run.summary.experiment.as_ref()).collect()
}

/// Returns the facts about a run that may distinguish it.
fn run_facts(RunDetail { summary, facts, .. }: &RunDetail) -> RunFacts<'_> {
    let placement = &summary.placement;
    RunFacts {
        model: Some(placement.model.as_str()).filter(|_| placement.kind != PlacementKind::None),
        device: placement.device.as_deref(),
        placement: placement.kind.name(),
        network: placement.network.as_deref(),
        edge: summary.host_name.as_str(),
        cloud: placement.peer.as_ref().map(Slug::as_str),
        facts,
        pipeline: Some(summary.pipeline.as_str()),
    }
}

#[cfg(test)]
mod tests {
    use peernet_analysis::compare::{Comparison, Configurations};
    use peernet_analysis::loaded::Loaded;
    use peernet_analysis::record::RunRecord;
    use peernet_analysis::rows::Rows;
    use peernet_store::RunSummary;

    use super::super::names::configuration_names;
    use super::super::tests::run;
    use super::*;

    fn detail(number: i64, facts: &[(&str, &str)]) -> RunDetail {
        let facts = facts.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        RunDetail { facts, ..run(number, PlacementKind::Local).into() }
    }

    #[test]
    fn hashes_paths_and_lists_have_name_but_no_column() {
        let hashes =
            ["model.py 5f4dcc3b5aa765d61d8327deb882cf99", "model.py 098f6bcd4621d373cade4e832627b4f6"];
        let long = "numpy 1.24.2, ".repeat(12);
        let run = |at: usize, load: &str, libraries: &str| {
            let facts =
                [("Load", load), ("Model files", hashes[at]), ("Model libraries", libraries), ("Same", "x")];
            detail(at as i64, &facts)
        };
        let settings = DifferingSettings::of_runs(&[run(0, "closed", &long), run(1, "20 Hz", "none")]);
        assert_eq!(settings.axes, ["Load"]);
        assert_eq!(settings.axis_values, [["closed"], ["20 Hz"]]);
        assert_eq!(settings.names_of_long_settings, ["Model files", "Model libraries"]);
    }

    /// Returns the axes and the values on these axes for two runs: first those of a page, then
    /// those of `peernet compare`. `change` sets the facts in which the two runs differ.
    fn columns_of_page_and_table(
        change: impl Fn(usize, &mut RunDetail),
    ) -> [(Vec<String>, Vec<Vec<String>>); 2] {
        let runs = [0, 1].map(|at| {
            let mut run = detail(at as i64, &[("Load", "closed")]);
            change(at, &mut run);
            run
        });
        let of_page = DifferingSettings::of_runs(&runs);
        let loaded = runs.map(|RunDetail { summary, facts, .. }| Loaded {
            folder: format!("folder-{}", summary.number).into(),
            record: RunRecord {
                format: 1,
                facts,
                experiment: summary.experiment.clone(),
                pipeline: serde_json::json!({ "name": summary.pipeline }),
                ..RunRecord::default()
            },
            rows: Rows::default(),
        });
        let of_table = Configurations::from_runs(&loaded);
        [(of_page.axes, of_page.axis_values), (of_table.axes, of_table.labels)]
    }

    #[test]
    fn page_and_table_name_runs_by_same_facts() {
        let labels = |labels: [&str; 2]| labels.map(|label| vec![label.to_owned()]).to_vec();
        let of_pipelines = columns_of_page_and_table(|at, run| {
            run.summary.pipeline = ["cam-a", "cam-b"][at].parse().expect("a name");
        });
        let expected = (vec!["pipeline".to_owned()], labels(["cam-a", "cam-b"]));
        assert_eq!(of_pipelines, [expected.clone(), expected]);

        let of_executions = columns_of_page_and_table(|at, run| {
            run.summary.experiment = Some(ExperimentPosition {
                name: "sizes".to_owned(),
                id: ["0123456789", "9876543210"][at].to_owned(),
                configuration: Vec::new(),
                ..ExperimentPosition::default()
            });
        });
        let expected = (vec!["execution".to_owned()], labels(["01234567", "98765432"]));
        assert_eq!(of_executions, [expected.clone(), expected]);
    }

    /// Returns the names of runs of one experiment: first those of a page, then those of
    /// `peernet compare`. `labels` are each run's values of `where`, `resize` and `edges`.
    fn names_of_page_and_table(labels: &[[&str; 3]]) -> [Vec<String>; 2] {
        let position = |labels: &[&str; 3]| ExperimentPosition {
            name: "sizes".to_owned(),
            id: "0123456789".to_owned(),
            configuration: ["where", "resize", "edges"]
                .into_iter()
                .zip(labels)
                .map(|(axis, label)| (axis.to_owned(), (*label).to_owned()))
                .collect(),
            ..ExperimentPosition::default()
        };
        let mut details: Vec<RunDetail> = (0..labels.len()).map(|at| detail(at as i64, &[])).collect();
        for (detail, labels) in details.iter_mut().zip(labels) {
            detail.summary.experiment = Some(position(labels));
        }
        let settings = DifferingSettings::of_runs(&details);
        let summaries: Vec<RunSummary> = details.iter().map(|detail| detail.summary.clone()).collect();
        let configurations =
            settings.axis_values.iter().map(Vec::as_slice).zip(summaries.iter().map(std::slice::from_ref));
        let of_page = configuration_names(&settings.axes, configurations);
        let loaded: Vec<Loaded> = labels
            .iter()
            .map(|labels| Loaded {
                folder: labels.join("-").into(),
                record: RunRecord { format: 1, experiment: Some(position(labels)), ..RunRecord::default() },
                rows: Rows::default(),
            })
            .collect();
        let of_table = Comparison::new(&loaded).lines.into_iter().map(|line| line.name).collect();
        [of_page, of_table]
    }

    #[test]
    fn page_and_table_name_selected_runs_equally() {
        let one_field = [["cloud", "yes", "1"], ["cloud", "no", "1"]];
        assert_eq!(names_of_page_and_table(&one_field), [["resize", "no resize"]; 2]);
        // The first field alone distinguishes the runs, but all fields that the author declared and
        // that differ are named.
        let two_fields = [["cloud", "yes", "1"], ["local", "no", "1"]];
        assert_eq!(names_of_page_and_table(&two_fields), [["cloud, resize", "local, no resize"]; 2]);
        // In words, both labels would be `no resize`. The names have each label after its axis instead.
        let namesakes = [["cloud", "no", "1"], ["cloud", "none", "1"]];
        assert_eq!(names_of_page_and_table(&namesakes), [["resize no", "resize none"]; 2]);
    }

    #[test]
    fn fewest_distinguishing_columns_are_chosen() {
        let run = |at, load: &str| detail(at, &[("Load", load), ("Threads", load), ("Sensor", "camera")]);
        let settings = DifferingSettings::of_runs(&[run(1, "closed"), run(2, "20 Hz")]);
        assert_eq!(settings.axes, ["Load"]);
        let labels = ["closed", "20 Hz"].map(str::to_owned).to_vec();
        assert_eq!(settings.other_settings, [Column { axis: "Threads".to_owned(), labels }]);
    }
}
