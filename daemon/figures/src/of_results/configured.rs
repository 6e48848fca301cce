//! Runs by configuration.

use peernet_analysis::compare::Configurations;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::rows::RowRef;

/// Runs of one configuration, its repeats, are taken together.
pub(super) struct Configured<'a> {
    /// What distinguishes the configurations.
    pub(super) axes: Vec<String>,
    /// Each configuration's label and runs.
    pub(super) groups: Vec<(String, Vec<&'a Loaded>)>,
}

impl<'a> Configured<'a> {
    pub(super) fn of(runs: &'a [Loaded]) -> Self {
        let Configurations { axes, labels } = Configurations::of(runs);
        let mut groups: Vec<(String, Vec<&Loaded>)> = Vec::new();
        for (labels, run) in labels.iter().zip(runs) {
            let label = labels.join(", ");
            match groups.iter_mut().find(|(other, _)| *other == label) {
                Some((_, runs)) => runs.push(run),
                None => groups.push((label, vec![run])),
            }
        }
        Self { axes, groups }
    }
}

/// Their rows that count.
pub(super) fn counted<'a>(runs: &[&'a Loaded]) -> impl Iterator<Item = RowRef<'a>> {
    runs.iter().flat_map(|run| &run.rows).filter(|row| row.counts())
}
