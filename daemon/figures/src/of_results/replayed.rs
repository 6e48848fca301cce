//! Marks of runs whose latencies were drawn from a distribution and not measured.

use peernet_analysis::compare::{Configurations, readable_names, replayed_configurations};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::RunRecord;
use peernet_analysis::trust::replayed_latencies;

use super::columns::with_name;

/// Mark after the name of a run or configuration.
const MARK: &str = "(replayed)";

/// Returns whether the latencies of a run are replayed.
pub(super) fn is_replayed(record: &RunRecord) -> bool {
    replayed_latencies(&record.facts).is_some()
}

/// Returns the name, with the mark if `is_replayed`.
pub(super) fn marked(name: &str, is_replayed: bool) -> String {
    match (is_replayed, name) {
        (false, _) => name.to_owned(),
        (true, "") => MARK.to_owned(),
        (true, _) => format!("{name} {MARK}"),
    }
}

/// Returns a title followed by the name of the run, which is marked if its latencies are replayed.
pub(super) fn with_run(title: &str, record: &RunRecord) -> String {
    with_name(title, &marked(&record.title, is_replayed(record)))
}

/// Returns whether a column contains the latency of the model, or a part of it. The other stages of a replayed run are measured.
pub(super) fn has_model_latency(column: &str) -> bool {
    ["inference", "total", "stages-total"].contains(&column) || column.starts_with("inference_")
}

/// Returns the note on the configurations whose latencies are replayed, each with its distribution; `None` if all are measured.
pub(super) fn note(runs: &[Loaded]) -> Option<String> {
    let Configurations { axes, labels } = Configurations::from_runs(runs);
    let mut configurations: Vec<(String, Option<&str>)> = Vec::new();
    for (run, name) in runs.iter().zip(readable_names(&axes, labels.iter().map(Vec::as_slice))) {
        if let (distribution @ Some(_), false) =
            (replayed_latencies(&run.record.facts), configurations.iter().any(|(other, _)| *other == name))
        {
            configurations.push((name, distribution));
        }
    }
    replayed_configurations(configurations)
}

/// Returns the note on a run whose latencies are replayed, with their distribution; `None` if they are measured.
pub(super) fn note_of_run(record: &RunRecord) -> Option<String> {
    replayed_configurations([(String::new(), replayed_latencies(&record.facts))])
}
