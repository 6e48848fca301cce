//! Order of an experiment's runs.

use std::collections::HashMap;

use peernet_analysis::compare::compare_positions;
use peernet_analysis::loaded::Loaded;
use peernet_stream::ExperimentPosition;

use super::experiment::Experiments;

/// Returns the indexes of the runs in the order of display. Runs of an experiment are in the [order of its
/// file](compare_positions), as on the dashboard. Runs of an earlier version do not have the index of their
/// configuration. The index is then taken from the record of the experiment, if the record can be read.
///
/// The runs of one experiment exchange their indexes among each other. All other results keep their indexes.
pub(super) fn declared_order(runs: &[Loaded], experiments: &Experiments) -> Vec<usize> {
    let mut order: Vec<usize> = (0..runs.len()).collect();
    let mut positions_by_experiment: HashMap<&str, Vec<(usize, ExperimentPosition)>> = HashMap::new();
    for (index, run) in runs.iter().enumerate() {
        if let Some(position) = &run.record.experiment {
            let configuration_index =
                position.configuration_index.or_else(|| recorded_index(run, position, experiments));
            positions_by_experiment
                .entry(&position.id)
                .or_default()
                .push((index, ExperimentPosition { configuration_index, ..position.clone() }));
        }
    }
    for positions in positions_by_experiment.into_values() {
        let mut sorted = positions.clone();
        // The sort is stable: the users of one run keep their order.
        sorted.sort_by(|(_, a), (_, b)| compare_positions(a, b));
        positions.into_iter().zip(sorted).for_each(|((index, _), (run, _))| order[index] = run);
    }
    order
}

/// Returns the index of a run's configuration in the record of its experiment.
fn recorded_index(run: &Loaded, position: &ExperimentPosition, experiments: &Experiments) -> Option<u32> {
    let configurations = &experiments.experiment_with_id(&run.folder, &position.id)?.plan.configurations;
    u32::try_from(
        configurations.iter().position(|configuration| configuration.labels == position.configuration)?,
    )
    .ok()
}

#[cfg(test)]
mod tests {
    use peernet_analysis::record::RunRecord;
    use peernet_analysis::rows::Rows;
    use serde_json::json;

    use super::*;
    use crate::experiment::RECORD;

    fn declared_order(runs: &[Loaded]) -> Vec<usize> {
        super::declared_order(runs, &Experiments::find(runs.iter().map(|run| &*run.folder)))
    }

    #[test]
    fn runs_have_order_of_experiment_file() {
        let experiment = tempfile::tempdir().expect("a folder");
        let folder = experiment.path().join("runs").join("1");
        std::fs::create_dir_all(&folder).expect("made");
        let run = |position: Option<(&str, u32)>, configuration_index: Option<u32>| {
            let position = position.map(|(label, repeat)| ExperimentPosition {
                name: "x".to_owned(),
                id: "x1".to_owned(),
                configuration: vec![("load".to_owned(), label.to_owned())],
                repeat,
                configuration_index,
                edges: None,
            });
            let record = RunRecord { experiment: position, ..RunRecord::default() };
            Loaded { folder: folder.clone(), record, rows: Rows::default() }
        };
        let runs = |a: Option<u32>, b: Option<u32>| {
            [
                run(Some(("a", 0)), a),
                run(None, None),
                run(Some(("b", 1)), b),
                run(Some(("b", 0)), b),
                run(Some(("b", 0)), b),
            ]
        };
        assert_eq!(declared_order(&runs(Some(1), Some(0))), [3, 1, 4, 2, 0]);
        // An earlier version recorded no index of the configuration. Without a record of the experiment, labels have
        // their natural order.
        assert_eq!(declared_order(&runs(None, None)), [0, 1, 3, 4, 2]);
        let configurations = ["b", "a"].map(|label| json!({ "labels": [["load", label]] }));
        let record =
            json!({ "format": 1, "id": "x1", "plan": { "configurations": configurations.as_slice() } });
        // With a record, labels have the order of the record.
        std::fs::write(experiment.path().join(RECORD), record.to_string()).expect("written");
        assert_eq!(declared_order(&runs(None, None)), [3, 1, 4, 2, 0]);
        assert!(declared_order(&[]).is_empty());
    }
}
