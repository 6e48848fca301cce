//! Title of a comparison: its finding in a sentence.

use peernet_analysis::compare::{Difference, MIN_BATCHES, Ranking};
use peernet_statistics::number::{Estimate, SPACE, column_decimals, duration};

use super::table::difference_decimals;
use super::{Comparison, Configuration, Differences};

/// Maximum number of configurations that a title names in addition to the best.
const MAX_NAMED: usize = 2;

/// Returns the finding of the comparison in a sentence.
pub(crate) fn title(comparison: &Comparison, differences: &Differences) -> String {
    let all = &comparison.configurations;
    let measured: Vec<&Configuration> = all.iter().filter(|one| comparison.total(one).is_some()).collect();
    let ranking = match (all.len(), measured.as_slice(), differences.ranking.as_ref()) {
        (0, ..) => return "No run of this experiment has finished yet".to_owned(),
        (1, ..) => return "One configuration: there is nothing to compare it with yet".to_owned(),
        (_, [], _) => return "No successful iteration of these runs is stored yet".to_owned(),
        (_, [only], _) => {
            return format!("Only {} has measured anything: there is nothing to compare it with", only.name);
        }
        (.., None) if all.len() == differences.unranked.len() + 1 => {
            return only_ranked_title(all, &differences.unranked);
        }
        (.., None) => {
            return "These configurations have no total in common that could be compared".to_owned();
        }
        (.., Some(ranking)) => ranking,
    };
    let best = &all[ranking.best];
    let mean = comparison.total(best).map_or_else(String::new, |total| duration(total.mean).to_string());
    let (ties, untested) = (ranking.ties(), ranking.untested());
    if !ties.is_empty() {
        return format!("{} and {} do not differ by more than chance", best.name, join_names(all, &ties));
    }
    if !untested.is_empty() {
        // If the untested configurations and the best one have enough iterations, then only the
        // buckets of whole seconds that this page reads are too few.
        // `peernet compare` reads single iterations and can therefore tell more.
        let mut untested_and_best = untested.iter().chain([&ranking.best]);
        let have_enough_iterations =
            untested_and_best.all(|index| ranking.with_enough_values.contains(index));
        let statement = match ranking.differences.len() {
            1 => format!("{} has the smaller mean, {mean}", best.name),
            others => {
                format!("{} has the smallest mean of the {} configurations, {mean}", best.name, others + 1)
            }
        };
        // If no difference was tested, the sentence is about all configurations and names none.
        let is_any_tested = untested.len() < ranking.differences.len();
        let untested_names = is_any_tested.then(|| join_names(all, &untested));
        if !have_enough_iterations {
            let of_untested = untested_names.map_or_else(String::new, |names| format!(" of {names}"));
            return format!("{statement}; too little is known{of_untested} to tell more");
        }
        let subject = match (untested_names, untested.as_slice()) {
            (None, _) => String::new(),
            (Some(names), [_]) => format!("{names} is "),
            (Some(names), _) => format!("{names} are "),
        };
        // A batch has at least one bucket, and a bucket covers at least one second, so this many seconds are needed.
        return format!(
            "{statement}; {subject}too short for this page (needs {MIN_BATCHES}{SPACE}s): peernet compare can tell"
        );
    }
    let Some((index, difference)) = reference_configuration(ranking, differences.baseline) else {
        return format!("{} is the fastest: {mean}", best.name);
    };
    let (lo, hi) = difference.interval.unwrap_or((difference.value, difference.value));
    // The tables of differences compare each configuration with the baseline. If one of the two
    // configurations of this difference is the baseline, the table of the other has this
    // difference, and the title shows the same decimals.
    let compared_with_baseline = if index == differences.baseline {
        Some(ranking.best)
    } else {
        (ranking.best == differences.baseline).then_some(index)
    };
    let stages = compared_with_baseline
        .and_then(|compared| differences.others.iter().find(|(other, _)| *other == compared));
    let decimals = match stages {
        Some((_, stages)) => difference_decimals(stages),
        None => column_decimals([difference.margin()]),
    };
    let difference_ms = Estimate::new(difference.value, (lo, hi)).with_decimals(decimals);
    format!(
        "{} is the fastest: {mean}, {}{SPACE}ms less than {} (95{SPACE}%: {})",
        best.name,
        difference_ms.value(),
        all[index].name,
        difference_ms.interval()
    )
}

/// Returns the title of a comparison in which all configurations but one are not ranked.
fn only_ranked_title(all: &[Configuration], unranked: &[usize]) -> String {
    let ranked = (0..all.len()).find(|index| !unranked.contains(index));
    let ranked = ranked.map_or("", |index| all[index].name.as_str());
    let names = join_names(all, unranked);
    match unranked {
        [_] => format!("Only {ranked} is ranked, because the model of {names} computes nothing"),
        _ => format!("Only {ranked} is ranked, because the models of {names} compute nothing"),
    }
}

/// Returns the configuration with which the title compares the best one: the baseline, or the
/// configuration with the next larger mean if the baseline is the best or is not ranked. `None` if
/// no difference was tested.
fn reference_configuration(ranking: &Ranking, baseline: usize) -> Option<(usize, Difference)> {
    let tested =
        || ranking.differences.iter().filter_map(|(index, difference)| Some((*index, (*difference)?)));
    let next = || tested().min_by(|a, b| a.1.value.total_cmp(&b.1.value));
    tested().find(|(index, _)| *index == baseline).or_else(next)
}

/// Returns the first [`MAX_NAMED`] names of these configurations, and the number of the others.
fn join_names(all: &[Configuration], indexes: &[usize]) -> String {
    let names: Vec<&str> = indexes.iter().take(MAX_NAMED).map(|index| all[*index].name.as_str()).collect();
    match indexes.len() - names.len() {
        0 => names.join(" and "),
        more => format!("{} and {more} more", names.join(", ")),
    }
}
