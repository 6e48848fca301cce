//! Edges that were measured at the same time, and the share of each of them.

use super::EdgeShare;
use crate::loaded::Loaded;
use crate::order::SortedValues;
use crate::rows::RowRef;

/// Returns the edges of each run, in the order of the input: those of one repeat of one configuration of an experiment.
pub(super) fn runs(edges: &[Loaded]) -> Vec<Vec<&Loaded>> {
    let mut runs: Vec<Vec<&Loaded>> = Vec::new();
    for edge in edges {
        let belongs = |run: &&mut Vec<&Loaded>| {
            let same = edge.record.experiment.is_some() && edge.record.experiment == run[0].record.experiment;
            // A copy of an edge's results is not a further edge.
            same && run.iter().all(|other| other.record.edge.name != edge.record.edge.name)
        };
        match runs.iter_mut().find(belongs) {
            Some(run) => run.push(edge),
            None => runs.push(vec![edge]),
        }
    }
    runs
}

/// Returns each edge's share and all totals, from the time in which all edges were measuring; `None` if there is no such time. For an edge
/// alone this is its whole run: all its totals count.
pub(super) fn shared(edges: &[&Loaded]) -> Option<(Vec<EdgeShare>, Vec<f64>)> {
    let rows: Vec<Vec<RowRef<'_>>> =
        edges.iter().map(|edge| edge.rows.iter().filter(|row| row.is_counted()).collect()).collect();
    let first = |rows: &Vec<RowRef<'_>>| rows.iter().map(|row| row.at()).reduce(f64::min);
    let last = |rows: &Vec<RowRef<'_>>| rows.iter().map(|row| row.at()).reduce(f64::max);
    let from = rows.iter().map(first).collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::max)?;
    let to = rows.iter().map(last).collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::min)?;
    (to > from).then_some(())?;
    let is_alone = edges.len() == 1;
    // The number of intervals is one less than the number of starts: the window begins with a start and ends with one.
    let within = |row: &RowRef<'_>| (from..to).contains(&row.at());
    let of = |rows: &Vec<RowRef<'_>>| {
        let totals = rows.iter().filter(|row| is_alone || within(row)).filter_map(|row| row.value("total"));
        (rows.iter().filter(|row| within(row)).count(), totals.collect())
    };
    let totals: Vec<(usize, Vec<f64>)> = rows.iter().map(of).collect();
    let share = |(count, totals): &(usize, Vec<f64>)| EdgeShare {
        rate: *count as f64 / (to - from),
        median: totals.iter().copied().collect::<SortedValues>().median(),
    };
    let shares = totals.iter().map(share).collect();
    Some((shares, totals.into_iter().flat_map(|(_, totals)| totals).collect()))
}
