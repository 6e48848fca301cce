//! Runs by configuration.

use peernet_analysis::compare::{Configurations, group_by_labels};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::rows::RowRef;

/// Runs by configuration; repeats of one configuration are pooled.
pub(super) struct ConfigurationGroups<'a> {
    /// Names of the labels that distinguish the configurations.
    pub(super) axes: Vec<String>,
    /// Label and runs of each configuration.
    pub(super) groups: Vec<(String, Vec<&'a Loaded>)>,
}

impl<'a> ConfigurationGroups<'a> {
    pub(super) fn from_runs(runs: &'a [Loaded]) -> Self {
        let Configurations { axes, labels } = Configurations::from_runs(runs);
        let group = |indexes: Vec<usize>| {
            let values = axes.iter().zip(&labels[indexes[0]]);
            let label =
                values.map(|(axis, value)| readable_value(axis, value)).collect::<Vec<_>>().join(", ");
            (label, indexes.into_iter().map(|index| &runs[index]).collect())
        };
        let groups = group_by_labels(&labels).into_iter().map(group).collect();
        Self { axes, groups }
    }
}

/// Returns the value of an axis as a text that is clear without the name of the axis: `no resize` instead of `no`, `edges 4` instead of `4`.
fn readable_value(axis: &str, value: &str) -> String {
    match value {
        "yes" | "true" | "on" => axis.to_owned(),
        "no" | "none" | "false" | "off" => format!("no {axis}"),
        number if number.parse::<f64>().is_ok() => format!("{axis} {number}"),
        name => name.to_owned(),
    }
}

/// Returns the counted rows of these runs: neither warm-up nor without an answer.
pub(super) fn counted_rows<'a>(runs: &[&'a Loaded]) -> impl Iterator<Item = RowRef<'a>> {
    runs.iter().flat_map(|run| &run.rows).filter(|row| row.is_counted())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_name_is_added_to_unclear_values_only() {
        let text = |axis, value| readable_value(axis, value);
        assert_eq!([text("resize", "no"), text("resize", "yes")], ["no resize", "resize"]);
        assert_eq!([text("edges", "4"), text("network", "LAN")], ["edges 4", "LAN"]);
    }
}
