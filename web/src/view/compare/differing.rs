//! Settings in which the runs of a comparison differ.

use peernet_analysis::compare::{ChosenColumns, Column, RunFacts, choose_columns, tabulate};
use peernet_logger::Slug;
use peernet_store::RunDetail;
use peernet_stream::PlacementKind;

/// Settings that distinguish runs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct DifferingSettings {
    /// Names of the settings that become columns.
    pub(super) axes: Vec<String>,
    /// The value of each run on each axis.
    pub(super) values: Vec<Vec<String>>,
    /// Further settings that differ, and declared settings of an experiment that are equal for all runs. Each has a value per run.
    pub(super) settings: Vec<Column>,
    /// Names of further settings that differ but are too long for a table, such as hashes, paths and lists.
    pub(super) long_settings: Vec<String>,
}

impl DifferingSettings {
    /// Returns the axes of the experiment's file.
    pub(super) fn of_experiment(runs: &[RunDetail]) -> Self {
        let all = tabulate(&runs.iter().map(declared_values).collect::<Vec<_>>());
        // A single configuration has no differences; it is identified by its declared values.
        let has_several = all.iter().any(Column::differs);
        let (columns, settings) = all.into_iter().partition(|column| !has_several || column.differs());
        Self::from_columns(runs.len(), ChosenColumns { columns, rest: settings })
    }

    /// Returns the smallest set of facts that distinguishes the runs.
    pub(super) fn of_runs(runs: &[RunDetail]) -> Self {
        let all = tabulate(&runs.iter().map(run_facts).collect::<Vec<_>>());
        Self::from_columns(runs.len(), choose_columns(all.into_iter().filter(Column::differs).collect()))
    }

    fn from_columns(runs: usize, ChosenColumns { columns, rest }: ChosenColumns) -> Self {
        let (long_settings, settings): (Vec<Column>, Vec<Column>) =
            rest.into_iter().partition(Column::is_opaque);
        let row = |run: usize| columns.iter().map(|column| column.labels[run].clone()).collect();
        Self {
            values: (0..runs).map(row).collect(),
            axes: columns.iter().map(|column| column.axis.clone()).collect(),
            settings,
            long_settings: long_settings.into_iter().map(|column| column.axis).collect(),
        }
    }
}

fn declared_values(run: &RunDetail) -> Vec<(String, String)> {
    run.summary.experiment.as_ref().map(|place| place.configuration.clone()).unwrap_or_default()
}

/// Returns the declared values of a run and the facts about it, as `peernet compare` does, and the name of its pipeline.
fn run_facts(run: &RunDetail) -> Vec<(String, String)> {
    let RunDetail { summary, facts, .. } = run;
    let placement = &summary.placement;
    let facts = RunFacts {
        model: Some(placement.model.as_str()).filter(|_| placement.kind != PlacementKind::None),
        device: placement.device.as_deref(),
        placement: placement.kind.name(),
        network: placement.network.as_deref(),
        edge: summary.host_name.as_str(),
        cloud: placement.peer.as_ref().map(Slug::as_str),
        facts,
    };
    let pipeline = vec![("pipeline".to_owned(), summary.pipeline.to_string())];
    [declared_values(run), facts.pairs(), pipeline].concat()
}

#[cfg(test)]
mod tests {
    use peernet_stream::PlacementKind;

    use super::super::tests::run;
    use super::*;

    fn detail(number: i64, facts: &[(&str, &str)]) -> RunDetail {
        let facts = facts.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        RunDetail { facts, ..run(number, PlacementKind::Local).into() }
    }

    #[test]
    fn hashes_paths_and_lists_are_named_without_column() {
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
        assert_eq!(settings.values, [["closed"], ["20 Hz"]]);
        assert_eq!(settings.long_settings, ["Model files", "Model libraries"]);
    }

    #[test]
    fn fewest_distinguishing_columns_are_chosen() {
        let run = |at, load: &str| detail(at, &[("Load", load), ("Threads", load), ("Sensor", "camera")]);
        let settings = DifferingSettings::of_runs(&[run(1, "closed"), run(2, "20 Hz")]);
        assert_eq!(settings.axes, ["Load"]);
        let labels = ["closed", "20 Hz"].map(str::to_owned).to_vec();
        assert_eq!(settings.settings, [Column { axis: "Threads".to_owned(), labels }]);
    }
}
