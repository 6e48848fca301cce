//! Edges that measured at the same time, and what they measured in that time.

use peernet_stream::ExperimentPosition;

use super::{EdgeMeasurements, Repeat, common_time};
use crate::loaded::Loaded;
use crate::order::SortedValues;
use crate::rows::RowRef;
use crate::total_column::TotalColumn;

/// Groups runs of edges that measured at the same time, which are the edges that measured the same repeat of the same
/// configuration of an experiment. A run without a position in an experiment is a group of its own. Groups and runs keep
/// the order of the input.
pub fn concurrent_groups<'a, R, E: PartialEq>(
    runs: impl IntoIterator<Item = &'a R>,
    position_of: impl Fn(&'a R) -> Option<&'a ExperimentPosition>,
    edge_of: impl Fn(&'a R) -> E,
) -> Vec<Vec<&'a R>> {
    let mut groups: Vec<Vec<&R>> = Vec::new();
    for run in runs {
        let position = position_of(run);
        let belongs_to = |group: &&mut Vec<&'a R>| {
            let is_same_repeat = position.is_some() && position == position_of(group[0]);
            // A copy of an edge's results is not a further edge of the group. The copy becomes a separate group.
            is_same_repeat && group.iter().all(|other| edge_of(other) != edge_of(run))
        };
        match groups.iter_mut().find(belongs_to) {
            Some(group) => group.push(run),
            None => groups.push(vec![run]),
        }
    }
    groups
}

/// Returns the complete groups: those with as many edges as the largest group of the same configuration.
// Without one of the edges, the other edges would get more of the cloud than configured.
pub fn complete_groups<'a, R>(
    groups: Vec<Vec<&'a R>>,
    position_of: impl Fn(&'a R) -> Option<&'a ExperimentPosition>,
) -> Vec<Vec<&'a R>> {
    let configuration_of =
        |group: &[&'a R]| position_of(group[0]).map(|position| (&position.id, &position.configuration));
    let configurations_and_edges: Vec<_> =
        groups.iter().map(|group| (configuration_of(group), group.len())).collect();
    let is_complete = |group: &Vec<&'a R>| {
        let configuration = configuration_of(group);
        let repeats = configurations_and_edges
            .iter()
            .filter(|(other, _)| configuration.is_some() && *other == configuration);
        repeats.map(|(_, edges)| *edges).max().is_none_or(|largest| group.len() == largest)
    };
    groups.into_iter().filter(is_complete).collect()
}

/// Returns what the edges of a repeat measured while all of them were measuring.
pub(super) fn repeat_from_edges(edges: &[&Loaded]) -> Repeat<SortedValues> {
    let rows: Vec<Vec<RowRef<'_>>> =
        edges.iter().map(|edge| edge.rows.iter().filter(RowRef::is_in_statistics).collect()).collect();
    let measured_time = |rows: &Vec<RowRef<'_>>| {
        let starts = || rows.iter().map(RowRef::at);
        Some((starts().reduce(f64::min)?, starts().reduce(f64::max)?))
    };
    let times: Vec<Option<(f64, f64)>> = rows.iter().map(measured_time).collect();
    let Some((from, to)) = common_time(times) else {
        return Repeat { common_seconds: None, edges: Vec::new() };
    };
    let edge = |rows: &Vec<RowRef<'_>>| {
        let within = rows.iter().filter(|row| (from..to).contains(&row.at()));
        EdgeMeasurements {
            starts: within.clone().count() as u64,
            totals: within.filter_map(|row| row.value(TotalColumn::Measured.name())).collect(),
        }
    };
    Repeat { common_seconds: Some(to - from), edges: rows.iter().map(edge).collect() }
}
