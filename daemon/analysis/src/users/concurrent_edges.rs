//! Edges that measured at the same time, and the share of each edge.

use super::EdgeShare;
use crate::loaded::Loaded;
use crate::order::SortedValues;
use crate::rows::RowRef;

/// Groups the edges that measured the same repeat of the same configuration of an experiment. The edges of a group measured at the same
/// time. Groups and edges keep the order of the input.
pub(super) fn concurrent_groups(edges: &[Loaded]) -> Vec<Vec<&Loaded>> {
    let mut groups: Vec<Vec<&Loaded>> = Vec::new();
    for edge in edges {
        let belongs_to = |group: &&mut Vec<&Loaded>| {
            let is_same_repeat =
                edge.record.experiment.is_some() && edge.record.experiment == group[0].record.experiment;
            // A copy of an edge's results is not a further edge of the group; it becomes a separate group.
            is_same_repeat && group.iter().all(|other| other.record.edge.name != edge.record.edge.name)
        };
        match groups.iter_mut().find(belongs_to) {
            Some(group) => group.push(edge),
            None => groups.push(vec![edge]),
        }
    }
    groups
}

/// Returns the share of each edge and the totals of all edges. Only the time in which all edges were measuring is used. `None` if there is
/// no such time. For a single edge, the whole run and all its totals are used.
pub(super) fn shares_and_totals(edges: &[&Loaded]) -> Option<(Vec<EdgeShare>, Vec<f64>)> {
    let rows: Vec<Vec<RowRef<'_>>> =
        edges.iter().map(|edge| edge.rows.iter().filter(|row| row.is_counted()).collect()).collect();
    let first = |rows: &Vec<RowRef<'_>>| rows.iter().map(|row| row.at()).reduce(f64::min);
    let last = |rows: &Vec<RowRef<'_>>| rows.iter().map(|row| row.at()).reduce(f64::max);
    let from = rows.iter().map(first).collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::max)?;
    let to = rows.iter().map(last).collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::min)?;
    (to > from).then_some(())?;
    let is_alone = edges.len() == 1;
    // For a rate, the starts must be as many as the periods between `from` and `to`. The start at `to` is therefore left out.
    let within = |row: &RowRef<'_>| (from..to).contains(&row.at());
    let starts_and_totals = |rows: &Vec<RowRef<'_>>| {
        let totals = rows.iter().filter(|row| is_alone || within(row)).filter_map(|row| row.value("total"));
        (rows.iter().filter(|row| within(row)).count(), totals.collect())
    };
    let edges: Vec<(usize, Vec<f64>)> = rows.iter().map(starts_and_totals).collect();
    let share = |(starts, totals): &(usize, Vec<f64>)| EdgeShare {
        rate: *starts as f64 / (to - from),
        median: totals.iter().copied().collect::<SortedValues>().median(),
    };
    let shares = edges.iter().map(share).collect();
    Some((shares, edges.into_iter().flat_map(|(_, totals)| totals).collect()))
}
