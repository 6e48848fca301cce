//! Groups of runs with the same configuration.

use peernet_analysis::compare::Configurations;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::rows::RowRef;

use super::replayed::{is_replayed, marked};

/// Runs, grouped by configuration. A group contains all repeats of its configuration.
pub(super) struct ConfigurationGroups<'a> {
    /// Names of the labels that distinguish the configurations.
    pub(super) axes: Vec<String>,
    /// Label and runs of each configuration. The label of a configuration with replayed latencies is marked.
    pub(super) groups: Vec<(String, Vec<&'a Loaded>)>,
}

impl<'a> ConfigurationGroups<'a> {
    pub(super) fn from_runs(runs: &'a [Loaded]) -> Self {
        let configurations = Configurations::from_runs(runs);
        let group = |(name, indexes): (String, Vec<usize>)| {
            // Repeats are pooled, so a single repeat with replayed latencies is enough for the mark.
            let is_replayed = indexes.iter().any(|index| is_replayed(&runs[*index].record));
            (marked(&name, is_replayed), indexes.into_iter().map(|index| &runs[index]).collect())
        };
        let groups = configurations.named_groups().into_iter().map(group).collect();
        Self { axes: configurations.axes, groups }
    }
}

/// Returns the rows of these runs that are in the statistics.
pub(super) fn rows_in_statistics<'a>(runs: &[&'a Loaded]) -> impl Iterator<Item = RowRef<'a>> + Clone {
    runs.iter().flat_map(|run| &run.rows).filter(|row| row.is_in_statistics())
}
