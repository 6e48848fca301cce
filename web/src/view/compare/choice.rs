//! Choice of the runs that are drawn if there are too many runs to draw all of them.

use peernet_statistics::number::list_first;
use peernet_store::RunSummary;

use super::{Comparison, Configuration};

/// Maximum number of runs that are drawn next to each other.
const MAX_DRAWN_RUNS: usize = 24;

/// A run with its configuration and its data to draw.
pub(super) type ChosenRun<'a, T> = (&'a Configuration, &'a RunSummary, T);

/// Chooses runs that have data: the first of each configuration, then the second of each, and so on, up to the maximum.
///
/// Returns the chosen runs in the order of the configurations. If not all runs with data were chosen, also returns the
/// number of all runs with data.
pub(super) fn choose_runs<'a, T>(
    comparison: &'a Comparison,
    data_of: impl Fn(&'a RunSummary) -> Option<T>,
) -> (Vec<ChosenRun<'a, T>>, Option<usize>) {
    let data_of = &data_of;
    let all = comparison.configurations.iter().enumerate().flat_map(|(index, one)| {
        let with_data = one.runs.iter().filter_map(move |run| Some((one, run, data_of(run)?)));
        with_data.enumerate().map(move |(repeat, run)| (repeat, index, run))
    });
    let mut all: Vec<(usize, usize, ChosenRun<'a, T>)> = all.collect();
    let count_with_data = all.len();
    // The first sorting decides which runs are kept. The second sorting makes the order of the result.
    all.sort_by_key(|(repeat, index, _)| (*repeat, *index));
    all.truncate(MAX_DRAWN_RUNS);
    all.sort_by_key(|(repeat, index, _)| (*index, *repeat));
    (
        all.into_iter().map(|(.., run)| run).collect(),
        (count_with_data > MAX_DRAWN_RUNS).then_some(count_with_data),
    )
}

/// Returns a sentence about the runs that cannot be drawn because none of their iterations succeeded; `None` if there are no such runs.
pub(super) fn unsuccessful_runs_sentence(comparison: &Comparison) -> Option<String> {
    let runs = comparison.runs().filter(|run| run.counts.ok == 0);
    let numbers: Vec<String> = runs.map(|run| format!("#{}", run.number)).collect();
    (!numbers.is_empty())
        .then(|| format!("No successful iteration after the warm-up: {}.", list_first(&numbers)))
}
