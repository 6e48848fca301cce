//! Names of configurations, made of the settings in which they differ.

use peernet_analysis::compare::readable_names;
use peernet_store::RunSummary;

/// Returns a unique name for each configuration from its value on each axis and its runs. The name
/// has the values in words. It also has the number of the first run if there are no values or
/// another configuration has the same values.
pub(super) fn configuration_names<'a>(
    axes: &[String],
    configurations: impl Iterator<Item = (&'a [String], &'a [RunSummary])>,
) -> Vec<String> {
    let (values, runs): (Vec<&[String]>, Vec<&[RunSummary]>) = configurations.unzip();
    let words = readable_names(axes, values);
    let name = |(own_words, runs): (&String, &&[RunSummary])| {
        let is_unique = words.iter().filter(|other| *other == own_words).count() == 1;
        let first_run = runs.first().map_or_else(String::new, |run| format!("#{}", run.number));
        match (own_words.is_empty(), is_unique) {
            (true, _) => first_run,
            (false, true) => own_words.clone(),
            (false, false) => format!("{own_words}, {first_run}"),
        }
    };
    words.iter().zip(&runs).map(name).collect()
}

#[cfg(test)]
mod tests {
    use peernet_statistics::number::NONE;
    use peernet_stream::PlacementKind::Local;

    use super::super::tests::run;
    use super::*;

    #[test]
    fn configuration_names_are_unique_and_never_empty() {
        let axes = ["where", "size"].map(str::to_owned);
        let values = [["cloud", "224"], ["local", NONE], ["local", NONE], [NONE, NONE]]
            .map(|values| values.map(str::to_owned));
        let runs: Vec<Vec<RunSummary>> = (1..5).map(|number| vec![run(number, Local)]).collect();
        let all = values.iter().map(|values| &values[..]).zip(runs.iter().map(Vec::as_slice));
        assert_eq!(configuration_names(&axes, all), ["cloud, size 224", "local, #2", "local, #3", "#4"]);
    }
}
