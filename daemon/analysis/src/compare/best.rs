//! Best line of a comparison, and the differences between the other lines and the best line.

use peernet_sample::printable_line;
use peernet_statistics::number::{column_decimals, fixed_ms};

use super::difference_table::{INTERVAL_LIMITATION, MEAN_INTERVAL_MEANING};
use super::ranking::{ConfigurationTotal, Ranking, find_unranked, model_computes};
use super::{Comparison, EMPTY_CELL, Line, MeanEstimate, accepted_values};
use crate::loaded::Loaded;
use crate::table::{CaptionedTable, Table};

/// Ranks the lines, and stores the difference of each other line to the best.
pub(super) fn rank_lines(comparison: &mut Comparison, runs: &[Loaded]) {
    let total = |line: &Line| {
        let totals =
            line.runs.iter().map(|run| accepted_values(&runs[*run].rows, comparison.total_column.name()));
        ConfigurationTotal {
            model_computes: line.runs.iter().all(|run| model_computes(&runs[*run].record.facts)),
            mean: MeanEstimate::from_values(&totals.collect::<Vec<_>>()),
        }
    };
    let totals: Vec<ConfigurationTotal> = comparison.lines.iter().map(total).collect();
    comparison.unranked = find_unranked(&totals);
    let Some(ranking) = Ranking::new(&totals) else { return };
    comparison.best = Some(ranking.best);
    (comparison.ties, comparison.untested) = (ranking.ties(), ranking.untested());
    for (index, difference) in ranking.differences {
        comparison.lines[index].difference_to_best = difference;
    }
}

/// Returns the table of the differences between the means of the other lines and the mean of the best line. A
/// comparison of three or more lines has this table instead of [`Differences`](super::Differences). `None` with fewer
/// than three lines, if no line is the best, or if no other line has a mean.
pub fn differences_to_best(comparison: &Comparison) -> Option<CaptionedTable> {
    let best = comparison.best.filter(|_| comparison.lines.len() > 2)?;
    comparison.lines.iter().find(|line| line.difference_to_best.is_some())?;
    let name = comparison.lines[best].name.clone();
    Some(CaptionedTable {
        heading: printable_line(&format!(
            "Mean total ({}) against the smallest, {name}.",
            comparison.total_word()
        ))
        .into_owned(),
        table: differences_table(comparison),
        notes: format!(
            "In ms. {MEAN_INTERVAL_MEANING} Each interval is computed alone: no interval is corrected for the number of \
             differences. {INTERVAL_LIMITATION}"
        ),
    })
}

/// Returns a row for each line that has a difference to the best line.
fn differences_table(comparison: &Comparison) -> Table {
    let Comparison { axes, lines, total_column, .. } = comparison;
    let others = || lines.iter().filter_map(|line| Some((line, line.difference_to_best?)));
    // All numbers of the column have the same number of decimals, so that they are easy to compare.
    let decimals = column_decimals(others().map(|(_, difference)| difference.margin()));
    let mut header = axes.clone();
    header.extend(["mean", "beyond the smallest", "95 % confidence"].map(str::to_owned));
    let rows = others().map(|(line, difference)| {
        let mean = line.latency(total_column.name()).map(|latency| fixed_ms(latency.mean, decimals));
        let mean = mean.unwrap_or_else(|| EMPTY_CELL.to_owned());
        let (difference, interval) = difference.texts(decimals);
        let interval = interval.unwrap_or_else(|| EMPTY_CELL.to_owned());
        line.labels.iter().cloned().chain([mean, difference, interval]).collect()
    });
    Table { header, label_columns: axes.len(), rows: rows.collect(), marked: None }
}

#[cfg(test)]
mod tests {
    use super::super::Repeats;
    use super::super::tests::paper;
    use super::*;
    use crate::rows::Outcome;

    #[test]
    fn other_lines_are_compared_with_the_best() {
        let comparison = Comparison::new(&paper());
        let against = differences_to_best(&comparison).expect("three lines");
        let expected = "\
Mean total (measured) against the smallest, orin.

device  network     mean  beyond the smallest  95 % confidence
cuda:0  lan       23.390               +3.130           +3.130
cuda:0  can      105.550              +85.290          +85.290
";
        assert!(against.text().starts_with(expected), "{}", against.text());
        assert!(
            against.text().contains(" no interval is corrected for the number of differences. "),
            "{}",
            against.text()
        );
        assert!(against.latex().contains("+3.130") && against.markdown().contains("| +3.130 |"));
        let expected_cells = comparison.lines[1].difference_to_best.expect("known").value_and_ends();
        let csv = comparison.csv();
        let header = csv.lines().next().expect("a header");
        let first = header.split(',').position(|name| name == "beyond-best").expect("a column");
        let cells = csv.lines().nth(2).into_iter().flat_map(|line| line.split(',').skip(first).take(3));
        assert_eq!(cells.map(|cell| cell.parse().ok()).collect::<Vec<Option<f64>>>(), expected_cells);
        assert!(
            differences_to_best(&Comparison::new(&paper()[..2])).is_none(),
            "two lines are compared stage by stage instead"
        );
    }

    #[test]
    fn sentence_on_ranking_excludes_unranked_line() {
        let mut runs = paper();
        runs[1].record.facts.push(("Model".to_owned(), "echo".to_owned()));
        let comparison = Comparison::new(&runs);
        assert_eq!((comparison.best, comparison.unranked.as_slice()), (Some(0), [1].as_slice()));
        let sentence = "orin; the other ranked line differs from it with 95 % confidence; not ranked, because the model computes nothing: cuda:0, lan.";
        assert!(comparison.text().contains(sentence), "{}", comparison.text());
    }

    #[test]
    fn missing_best_line_is_explained() {
        let mut runs = paper();
        runs[1].record.facts.push(("Model".to_owned(), "echo".to_owned()));
        let comparison = Comparison::new(&runs[..2]);
        assert_eq!((comparison.best, comparison.unranked.as_slice()), (None, [1].as_slice()));
        let sentence = "No line has the smallest mean total, because only orin is ranked; not ranked, because the model computes nothing: cuda:0.";
        assert!(comparison.text().contains(sentence), "{}", comparison.text());
        assert!(comparison.markdown().contains(sentence) && comparison.latex().contains(sentence));
        for run in [0, 2] {
            runs[run].rows.change(|row| row.outcome = Outcome::Lost);
        }
        let comparison = Comparison::new(&runs);
        assert_eq!((comparison.best, comparison.unranked.as_slice()), (None, [1].as_slice()));
        let sentence = "No line has the smallest mean total, because no ranked line has a total; not ranked, because the model computes nothing: cuda:0, lan.";
        assert!(comparison.text().contains(sentence), "{}", comparison.text());
    }

    #[test]
    fn line_of_few_iterations_has_no_interval() {
        let mut runs = paper();
        runs[1].rows.change(|row| row.warm_up = row.iteration > 20);
        let comparison = Comparison::new(&runs);
        let text = differences_to_best(&comparison).expect("three lines").text();
        let lan = text.lines().find(|line| line.contains("lan")).expect("a line");
        assert!(lan.contains("+3.13") && lan.ends_with('—'), "{text}");
        assert_eq!(comparison.untested, [1]);
    }

    #[test]
    fn line_without_measurements_is_untested() {
        let mut runs = paper();
        runs[1].rows.change(|row| row.outcome = Outcome::Lost);
        for (runs, repeats) in
            [(&runs[..2], Repeats::Pooled), (&runs[..2], Repeats::Separate), (&runs[..], Repeats::Pooled)]
        {
            let comparison = Comparison::with_repeats(runs, repeats);
            assert_eq!((comparison.best, comparison.untested.as_slice()), (Some(0), [1].as_slice()));
            let sentence = "too few iterations to tell whether it differs from cuda:0";
            assert!(comparison.text().contains(sentence), "{}", comparison.text());
            assert!(comparison.markdown().contains(sentence) && comparison.latex().contains(sentence));
            assert!(!comparison.text().contains("other line differs"), "{}", comparison.text());
            let line = comparison.csv().lines().nth(2).map(str::to_owned).expect("a line");
            assert!(line.contains(",1,0,101,0,,"), "the cell `tie` is empty: {line}");
        }
    }
}
