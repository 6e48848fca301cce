//! Choice of the runs that are drawn if there are too many to draw each of them.

use peernet_statistics::number::count;
use peernet_store::RunSummary;

use super::{Comparison, Configuration};

/// Maximum number of runs that are drawn next to each other.
const MAX_DRAWN_RUNS: usize = 24;

/// Maximum number of runs that a sentence names.
const MAX_NAMED_RUNS: usize = 8;

/// A run with its configuration and its data to draw.
pub(super) type Chosen<'a, T> = (&'a Configuration, &'a RunSummary, T);

/// Returns the first run of each configuration with data, then the second, as far as there is room, in the order of
/// configurations; and the number of all runs, where not all are drawn.
pub(super) fn chosen<'a, T>(
    comparison: &'a Comparison,
    known: impl Fn(&'a RunSummary) -> Option<T>,
) -> (Vec<Chosen<'a, T>>, Option<usize>) {
    let known = &known;
    let all = comparison.configurations.iter().enumerate().flat_map(|(place, one)| {
        let measured = one.runs.iter().filter_map(move |run| Some((one, run, known(run)?)));
        measured.enumerate().map(move |(repeat, run)| (repeat, place, run))
    });
    let mut all: Vec<(usize, usize, Chosen<'a, T>)> = all.collect();
    let measured = all.len();
    all.sort_by_key(|(repeat, place, _)| (*repeat, *place));
    all.truncate(MAX_DRAWN_RUNS);
    all.sort_by_key(|(repeat, place, _)| (*place, *repeat));
    (all.into_iter().map(|(.., run)| run).collect(), (measured > MAX_DRAWN_RUNS).then_some(measured))
}

/// Returns a sentence about the runs that have no picture because not one of their iterations was answered; `None` where there are
/// no such runs.
pub(super) fn without_answer(comparison: &Comparison) -> Option<String> {
    let runs: Vec<&RunSummary> = comparison.runs().filter(|run| run.counts.ok == 0).collect();
    let named: Vec<String> = runs.iter().take(MAX_NAMED_RUNS).map(|run| format!("#{}", run.number)).collect();
    let more = match runs.len().saturating_sub(MAX_NAMED_RUNS) {
        0 => String::new(),
        more => format!(" and {} more", count(more as u64)),
    };
    (!runs.is_empty())
        .then(|| format!("No answered iteration after the warm-up: {}{more}.", named.join(", ")))
}
