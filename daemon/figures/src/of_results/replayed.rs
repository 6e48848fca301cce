//! Marks of runs whose latencies were drawn from a distribution and not measured.

use peernet_analysis::compare::{Configurations, replayed_configurations};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;
use peernet_analysis::trust::ReplayedLatencies;

use super::columns::title_with_name;

/// Mark after the name of a run or configuration.
const MARK: &str = "(replayed)";

/// Returns whether the latencies of a run are replayed.
pub(super) fn is_replayed(record: &RunRecord) -> bool {
    ReplayedLatencies::from_facts(&record.facts).is_some()
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
pub(super) fn title_with_marked_name(title: &str, record: &RunRecord) -> String {
    title_with_name(title, &marked(&record.title, is_replayed(record)))
}

/// Returns the title of a figure of one column, followed by the name of the run. The name is marked if the column
/// contains replayed latencies.
pub(super) fn title_of_column(title: &str, column: &str, record: &RunRecord) -> String {
    if contains_model_latency(column) {
        title_with_marked_name(title, record)
    } else {
        title_with_name(title, &record.title)
    }
}

/// Returns whether a column contains the latency of the model, a part of this latency or a sum with it. The other
/// stages of a run with replayed latencies are measured.
pub(super) fn contains_model_latency(column: &str) -> bool {
    ["inference", "total", "stages-total"].contains(&column) || column.starts_with("inference_")
}

/// Returns the note on the configurations whose latencies are replayed, each with its distribution; `None` if the
/// latencies of all configurations are measured.
pub(super) fn note(runs: &[Loaded]) -> Option<String> {
    let describe = |(name, indexes): (String, Vec<usize>)| {
        let runs = indexes.into_iter().map(|index| &runs[index]);
        let replayed = runs.filter_map(|run| ReplayedLatencies::from_run(&run.record.facts, &run.rows));
        (name, ReplayedLatencies::describe_all(replayed))
    };
    let groups = Configurations::from_runs(runs).named_groups();
    let described: Vec<(String, Option<String>)> = groups.into_iter().map(describe).collect();
    replayed_configurations(described.iter().map(|(name, text)| (name.clone(), text.as_deref())))
}

/// Returns the note on a run whose latencies are replayed, with their distribution; `None` if the latencies are
/// measured.
pub(super) fn note_of_run(record: &RunRecord, rows: &Rows) -> Option<String> {
    let replayed = ReplayedLatencies::from_run(&record.facts, rows)?.describe();
    replayed_configurations([(String::new(), Some(replayed.as_str()))])
}
