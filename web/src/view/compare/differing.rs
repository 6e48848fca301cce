//! What the runs of a comparison differ in.

use peernet_report::compare::is_opaque;
use peernet_statistics::number::NONE;
use peernet_store::RunDetail;
use peernet_stream::ExperimentPlace;

use crate::view::place;

/// What is not the same for all runs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Differing {
    /// What becomes a column.
    pub(super) axes: Vec<String>,
    /// The value of each run on each axis.
    pub(super) values: Vec<Vec<String>>,
    /// Names of what differs as well, in hashes, paths or lists that no table has room for.
    pub(super) also: Vec<String>,
}

impl Differing {
    /// The axes of the experiment's file.
    pub(super) fn of_experiment(runs: &[RunDetail]) -> Self {
        let configuration = |run: &RunDetail| {
            let place = run.summary.experiment.as_ref();
            place.map_or(&[][..], |place: &ExperimentPlace| &place.configuration).to_vec()
        };
        Self::tabulated(runs, configuration)
    }

    /// What is known of the runs and not the same for all of them.
    pub(super) fn of_runs(runs: &[RunDetail]) -> Self {
        let Self { axes, values, .. } = Self::tabulated(runs, known);
        let differs = |at: usize| values.iter().any(|row| row[at] != values[0][at]);
        // Several names for one difference are one difference.
        let same = |a: usize, b: usize| values.iter().all(|row| row[a] == row[b]);
        let differing: Vec<usize> =
            (0..axes.len()).filter(|at| differs(*at) && !(0..*at).any(|before| same(before, *at))).collect();
        let is_opaque = |at: &usize| is_opaque(values.iter().map(|row| row[*at].as_str()));
        let (also, kept): (Vec<usize>, Vec<usize>) = differing.into_iter().partition(is_opaque);
        let names = |places: &[usize]| places.iter().map(|at| axes[*at].clone()).collect();
        let pick = |row: &Vec<String>| kept.iter().map(|at| row[*at].clone()).collect();
        Self { axes: names(&kept), values: values.iter().map(pick).collect(), also: names(&also) }
    }

    /// All names that any run has, in the order in which they come.
    fn tabulated(runs: &[RunDetail], pairs: impl Fn(&RunDetail) -> Vec<(String, String)>) -> Self {
        let rows: Vec<Vec<(String, String)>> = runs.iter().map(pairs).collect();
        let mut axes: Vec<String> = Vec::new();
        for (axis, _) in rows.iter().flatten() {
            if !axes.contains(axis) {
                axes.push(axis.clone());
            }
        }
        let value = |row: &[(String, String)], axis: &String| {
            let found = row.iter().find(|(name, _)| name == axis);
            found.map_or_else(|| NONE.to_owned(), |(_, value)| value.clone())
        };
        let values = rows.iter().map(|row| axes.iter().map(|axis| value(row, axis)).collect()).collect();
        Self { axes, values, also: Vec::new() }
    }
}

fn known(run: &RunDetail) -> Vec<(String, String)> {
    let summary = &run.summary;
    let mut pairs = vec![
        ("Pipeline".to_owned(), summary.pipeline.to_string()),
        ("Where".to_owned(), place::route(summary.host_name.as_str(), &summary.placement)),
        ("Model".to_owned(), place::model(&summary.placement)),
    ];
    pairs.extend(summary.placement.network.iter().map(|network| ("Network".to_owned(), network.clone())));
    pairs.extend(summary.experiment.iter().flat_map(|place| place.configuration.clone()));
    pairs.extend(run.facts.iter().cloned());
    pairs
}

#[cfg(test)]
mod tests {
    use peernet_stream::PlacementKind;

    use super::super::tests::run;
    use super::*;

    fn detail(number: i64, facts: &[(&str, &str)]) -> RunDetail {
        let facts = facts.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
        RunDetail { facts, ..run(number, PlacementKind::Local).into() }
    }

    #[test]
    fn hashes_paths_and_lists_are_named_and_are_no_columns() {
        let hashes =
            ["model.py 5f4dcc3b5aa765d61d8327deb882cf99", "model.py 098f6bcd4621d373cade4e832627b4f6"];
        let long = "numpy 1.24.2, ".repeat(12);
        let of = |at: usize, load: &str, libraries: &str| {
            let facts =
                [("Load", load), ("Model files", hashes[at]), ("Model libraries", libraries), ("Same", "x")];
            detail(at as i64, &facts)
        };
        let found = Differing::of_runs(&[of(0, "closed", &long), of(1, "20 Hz", "none")]);
        assert_eq!(found.axes, ["Load"]);
        assert_eq!(found.values, [["closed"], ["20 Hz"]]);
        assert_eq!(found.also, ["Model files", "Model libraries"]);
    }
}
