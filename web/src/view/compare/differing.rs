//! Settings in which the runs of a comparison differ.

use peernet_analysis::compare::{ChosenColumns, Column, choose_columns};
use peernet_statistics::number::NONE;
use peernet_store::RunDetail;

use crate::view::place;

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
        let declared_values = |run: &RunDetail| {
            let experiment = run.summary.experiment.as_ref();
            experiment.map_or_else(Vec::new, |experiment| experiment.configuration.clone())
        };
        let all = collect_columns(runs, declared_values);
        // A single configuration has no differences; it is identified by its declared values.
        let has_several = all.iter().any(Column::differs);
        let (columns, settings) = all.into_iter().partition(|column| !has_several || column.differs());
        Self::from_columns(runs.len(), ChosenColumns { columns, rest: settings })
    }

    /// Returns the smallest set of facts that distinguishes the runs.
    pub(super) fn of_runs(runs: &[RunDetail]) -> Self {
        let all = collect_columns(runs, run_facts).into_iter().filter(Column::differs);
        Self::from_columns(runs.len(), choose_columns(all.collect()))
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

/// Collects the facts of all runs, in the order of their first appearance.
fn collect_columns(
    runs: &[RunDetail],
    facts_of: impl Fn(&RunDetail) -> Vec<(String, String)>,
) -> Vec<Column> {
    let facts: Vec<Vec<(String, String)>> = runs.iter().map(facts_of).collect();
    let mut columns: Vec<Column> = Vec::new();
    for (run, (axis, value)) in
        facts.iter().enumerate().flat_map(|(run, facts)| facts.iter().map(move |fact| (run, fact)))
    {
        let index = columns.iter().position(|column| column.axis == *axis).unwrap_or_else(|| {
            columns.push(Column { axis: axis.clone(), labels: vec![NONE.to_owned(); runs.len()] });
            columns.len() - 1
        });
        columns[index].labels[run].clone_from(value);
    }
    columns
}

fn run_facts(run: &RunDetail) -> Vec<(String, String)> {
    let summary = &run.summary;
    let mut pairs = vec![
        ("Pipeline".to_owned(), summary.pipeline.to_string()),
        ("Where".to_owned(), place::route(summary.host_name.as_str(), &summary.placement)),
        ("Model".to_owned(), place::model(&summary.placement)),
    ];
    pairs.extend(summary.placement.network.iter().map(|network| ("Network".to_owned(), network.clone())));
    pairs.extend(summary.experiment.iter().flat_map(|place| place.configuration.clone()));
    pairs.extend(run.facts.iter().cloned());
    pairs
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
