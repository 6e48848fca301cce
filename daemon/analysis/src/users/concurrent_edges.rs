//! Edges that measured at the same time, and what they measured in that time.

use super::{EdgeMeasured, Repeat, common_time};
use crate::loaded::Loaded;
use crate::order::SortedValues;
use crate::rows::RowRef;
use crate::total_column::TotalColumn;

/// Groups the results of edges that measured at the same time, which are the edges that measured the same repeat of the
/// same configuration of an experiment. Groups and edges keep the order of the input.
pub(super) fn concurrent_groups(edges: &[Loaded]) -> Vec<Vec<&Loaded>> {
    let mut groups: Vec<Vec<&Loaded>> = Vec::new();
    for edge in edges {
        let belongs_to = |group: &&mut Vec<&Loaded>| {
            let is_same_repeat =
                edge.record.experiment.is_some() && edge.record.experiment == group[0].record.experiment;
            // A copy of an edge's results is not a further edge of the group. The copy becomes a separate group.
            is_same_repeat && group.iter().all(|other| other.record.edge.name != edge.record.edge.name)
        };
        match groups.iter_mut().find(belongs_to) {
            Some(group) => group.push(edge),
            None => groups.push(vec![edge]),
        }
    }
    groups
}

/// Returns the complete groups: those with as many edges as the largest group of the same configuration.
pub(super) fn complete_groups(groups: Vec<Vec<&Loaded>>) -> Vec<Vec<&Loaded>> {
    let configuration_of = |group: &[&Loaded]| {
        let position = group[0].record.experiment.as_ref()?;
        Some((position.id.clone(), position.configuration.clone()))
    };
    let configurations_and_edges: Vec<_> =
        groups.iter().map(|group| (configuration_of(group), group.len())).collect();
    let is_complete = |group: &Vec<&Loaded>| {
        let own = configuration_of(group);
        let same = configurations_and_edges.iter().filter(|(other, _)| own.is_some() && *other == own);
        same.map(|(_, edges)| *edges).max().is_none_or(|most| group.len() == most)
    };
    groups.into_iter().filter(is_complete).collect()
}

/// Returns what the edges of a repeat measured while all of them were measuring.
pub(super) fn repeat(edges: &[&Loaded]) -> Repeat<SortedValues> {
    let rows: Vec<Vec<RowRef<'_>>> =
        edges.iter().map(|edge| edge.rows.iter().filter(RowRef::is_in_statistics).collect()).collect();
    let measured_time = |rows: &Vec<RowRef<'_>>| {
        let starts = || rows.iter().map(RowRef::at);
        Some((starts().reduce(f64::min)?, starts().reduce(f64::max)?))
    };
    let times: Vec<Option<(f64, f64)>> = rows.iter().map(measured_time).collect();
    let Some((from, to)) = common_time(times) else { return Repeat { seconds: None, edges: Vec::new() } };
    let edge = |rows: &Vec<RowRef<'_>>| {
        let within = rows.iter().filter(|row| (from..to).contains(&row.at()));
        EdgeMeasured {
            starts: within.clone().count() as u64,
            totals: within.filter_map(|row| row.value(TotalColumn::Measured.name())).collect(),
        }
    };
    Repeat { seconds: Some(to - from), edges: rows.iter().map(edge).collect() }
}
