//! Groups of edges that measured at the same time.

use peernet_stream::ExperimentPosition;

/// Groups runs of edges that measured at the same time, which are the edges that measured the same repeat of the same
/// configuration of an experiment. A run without a position in an experiment is a separate group. Groups and runs keep
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

/// Returns the complete groups: those with the number of edges that the experiment records. If it
/// records none, those with as many edges as the largest group of the same configuration. A group
/// outside of experiments is complete.
// An incomplete group is left out: without one of its edges, the other edges got more of the cloud than configured.
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
        let recorded = position_of(group[0]).and_then(|position| position.edges);
        let edges = recorded.map(|edges| edges as usize).or_else(|| repeats.map(|(_, edges)| *edges).max());
        edges.is_none_or(|edges| group.len() >= edges)
    };
    groups.into_iter().filter(is_complete).collect()
}
