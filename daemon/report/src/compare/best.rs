//! The best line, and how far the others are from it.

use peernet_sample::printable_line;
use peernet_statistics::number::column_decimals;

use super::render::{WHAT_IT_DOES_NOT, WHAT_IT_SAYS, in_milliseconds, with_interval};
use super::{Comparison, Difference, NOTHING, Sample, Statistic, difference, values};
use crate::loaded::Loaded;
use crate::table::{Captioned, Table};

/// Finds the best line and what the others have more.
pub(super) fn mark(comparison: &mut Comparison, runs: &[Loaded], seed: u64) {
    let means = comparison
        .lines
        .iter()
        .enumerate()
        .filter_map(|(at, line)| Some((at, line.latency(comparison.by)?.mean)));
    let best = means.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(at, _)| at);
    let Some(best) = best.filter(|_| comparison.lines.len() > 1) else { return };
    let values = |at: usize| {
        let of_line = comparison.lines[at].runs.iter().map(|run| values(&runs[*run].rows, comparison.by));
        Sample::new(of_line.collect())
    };
    let of_best = values(best);
    let others = (0..comparison.lines.len()).filter(|at| *at != best);
    let beyond: Vec<(usize, Option<Difference>)> =
        others.map(|at| (at, difference(&of_best, &values(at), Statistic::Mean, seed))).collect();
    for (at, difference) in beyond {
        comparison.lines[at].beyond_best = difference;
        match difference.and_then(|difference| difference.is_distinct()) {
            Some(true) => {}
            Some(false) => comparison.ties.push(at),
            None => comparison.untested.push(at),
        }
    }
    comparison.best = Some(best);
}

/// How much larger the means of the others are than the best's: what three lines and more have in the place of
/// [`Differences`](super::Differences). `None` where none is the best, or no other has a mean.
pub fn against_best(comparison: &Comparison) -> Option<Captioned> {
    let best = comparison.best.filter(|_| comparison.lines.len() > 2)?;
    comparison.lines.iter().find(|line| line.beyond_best.is_some())?;
    let name = comparison.lines[best].name();
    Some(Captioned {
        heading: printable_line(&format!(
            "Mean total ({}) against the smallest, {name}.",
            comparison.total()
        ))
        .into_owned(),
        table: beyond_best(comparison),
        notes: format!(
            "In ms. {WHAT_IT_SAYS} Each holds for itself: they are not corrected for their number. \
             {WHAT_IT_DOES_NOT}"
        ),
    })
}

fn beyond_best(comparison: &Comparison) -> Table {
    let Comparison { axes, lines, by, .. } = comparison;
    let others = || lines.iter().filter_map(|line| Some((line, line.beyond_best?)));
    // As many in a whole column, so that its figures compare.
    let decimals = others().map(|(_, difference)| column_decimals(difference.margin()));
    let decimals = decimals.max().unwrap_or_default();
    let mut header = axes.clone();
    header.extend(["mean", "beyond the smallest", "95 % confidence"].map(str::to_owned));
    let rows = others().map(|(line, difference)| {
        let mean = line.latency(by).map(|latency| in_milliseconds(latency.mean, decimals));
        let mean = mean.unwrap_or_else(|| NOTHING.to_owned());
        line.labels.iter().cloned().chain([mean]).chain(with_interval(difference, decimals)).collect()
    });
    Table { header, labels: axes.len(), rows: rows.collect(), marked: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::super::tests::paper;
    use super::super::{Repeats, SEED};
    use super::*;
    use crate::rows::Outcome;

    #[test]
    fn every_other_line_is_compared_with_the_best() {
        let comparison = Comparison::of(&paper());
        let against = against_best(&comparison).expect("three lines");
        let expected = "\
Mean total (measured) against the smallest, orin.

device  network     mean  beyond the smallest     95 % confidence
cuda:0  lan       23.390               +3.130    +3.130 to +3.130
cuda:0  can      105.550              +85.290  +85.290 to +85.290
";
        assert!(against.text().starts_with(expected), "{}", against.text());
        assert!(against.text().contains(" they are not corrected for their number. "), "{}", against.text());
        assert!(against.latex().contains("+3.130") && against.markdown().contains("| +3.130 |"));
        let ends = comparison.lines[1].beyond_best.expect("known").ends();
        let csv = comparison.csv();
        let cells = csv.lines().nth(2).into_iter().flat_map(|line| line.rsplit(',').take(3));
        assert_eq!(
            cells.map(|cell| cell.parse().ok()).collect::<Vec<Option<f64>>>(),
            [ends[2], ends[1], ends[0]]
        );
        assert!(against_best(&Comparison::of(&paper()[..2])).is_none(), "two have their stages");
    }

    #[test]
    fn a_line_of_too_few_iterations_has_no_interval() {
        let mut runs = paper();
        runs[1].rows.change(|row| row.warm_up = row.iteration > 20);
        let comparison = Comparison::of(&runs);
        let text = against_best(&comparison).expect("three lines").text();
        let lan = text.lines().find(|line| line.contains("lan")).expect("a line");
        assert!(lan.contains("+3.13") && lan.ends_with('—'), "{text}");
        assert_eq!(comparison.untested, [1]);
    }

    #[test]
    fn nothing_is_known_of_a_line_that_measured_nothing() {
        let mut runs = paper();
        runs[1].rows.change(|row| row.outcome = Outcome::Lost);
        for (runs, repeats) in
            [(&runs[..2], Repeats::Pooled), (&runs[..2], Repeats::Apart), (&runs[..], Repeats::Pooled)]
        {
            let comparison = Comparison::with(runs, repeats, SEED);
            assert_eq!((comparison.best, comparison.untested.as_slice()), (Some(0), [1].as_slice()));
            let told = "too few iterations to tell whether it differs from cuda:0";
            assert!(comparison.text().contains(told), "{}", comparison.text());
            assert!(comparison.markdown().contains(told) && comparison.latex().contains(told));
            assert!(!comparison.text().contains("other differs"), "{}", comparison.text());
            let line = comparison.csv().lines().nth(2).map(str::to_owned).expect("a line");
            assert!(line.contains(",1,0,101,0,,"), "no tie is known: {line}");
        }
    }
}
