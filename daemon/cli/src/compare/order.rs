//! Order of an experiment's runs.

use std::collections::HashMap;

use peernet_analysis::loaded::Loaded;

use super::experiment::Experiments;

/// Returns the indexes of the runs in the order of display. Runs of an experiment are in the order of its file, as in `peernet run`.
///
/// The runs of one experiment exchange positions among each other. All other results keep their positions. If the folder of an experiment
/// does not exist or cannot be read, its runs keep their order.
pub(super) fn declared_order(runs: &[Loaded], experiments: &Experiments) -> Vec<usize> {
    let mut order: Vec<usize> = (0..runs.len()).collect();
    let mut executions: HashMap<&str, Vec<usize>> = HashMap::new();
    for (index, run) in runs.iter().enumerate() {
        if let Some(experiment_place) = &run.record.experiment {
            executions.entry(&experiment_place.id).or_default().push(index);
        }
    }
    for (id, indexes) in executions {
        let experiment_of = |index: &usize| experiments.execution(&runs[*index].folder, id);
        let Some(experiment) = indexes.iter().find_map(experiment_of) else { continue };
        let rank = |index: &usize| {
            let experiment_place = runs[*index].record.experiment.as_ref();
            let configurations = &experiment.plan.configurations;
            experiment_place.map(|experiment_place| {
                let index = configurations
                    .iter()
                    .position(|configuration| configuration.labels == experiment_place.configuration);
                (index.unwrap_or(configurations.len()), experiment_place.repeat)
            })
        };
        let mut sorted = indexes.clone();
        // The sort is stable: the users of one run keep their order.
        sorted.sort_by_key(rank);
        indexes.into_iter().zip(sorted).for_each(|(position, run)| order[position] = run);
    }
    order
}

#[cfg(test)]
mod tests {
    use peernet_analysis::record::RunRecord;
    use peernet_analysis::rows::Rows;
    use peernet_stream::ExperimentPlace;
    use serde_json::json;

    use std::fs;

    use super::*;
    use crate::experiment::RECORD;

    fn declared_order(runs: &[Loaded]) -> Vec<usize> {
        super::declared_order(runs, &Experiments::find(runs.iter().map(|run| &*run.folder)))
    }

    #[test]
    fn runs_have_order_of_file() {
        let experiment = tempfile::tempdir().expect("a folder");
        let labels = |label: &str| vec![("load".to_owned(), label.to_owned())];
        let configurations: Vec<_> = ["b", "a"].map(|label| json!({ "labels": labels(label) })).to_vec();
        let record = json!({ "format": 1, "id": "x1", "plan": { "configurations": configurations } });
        fs::write(experiment.path().join(RECORD), record.to_string()).expect("written");
        let run = |folder: &str, place: Option<(&str, u32)>| {
            let folder = experiment.path().join("runs").join(folder);
            fs::create_dir_all(&folder).expect("made");
            let place = place.map(|(label, repeat)| ExperimentPlace {
                name: "x".to_owned(),
                id: "x1".to_owned(),
                configuration: labels(label),
                repeat,
            });
            Loaded {
                folder,
                record: RunRecord { experiment: place, ..RunRecord::default() },
                rows: Rows::default(),
            }
        };
        let mut runs = vec![
            run("1", Some(("a", 0))),
            run("stranger", None),
            run("2", Some(("b", 1))),
            run("3/user-1", Some(("b", 0))),
            run("3/user-2", Some(("b", 0))),
        ];
        assert_eq!(declared_order(&runs), [3, 1, 4, 2, 0]);
        fs::remove_file(experiment.path().join(RECORD)).expect("removed");
        assert_eq!(declared_order(&runs), [0, 1, 2, 3, 4], "as they came");
        runs.clear();
        assert!(declared_order(&runs).is_empty());
    }
}
