//! `peernet compare`: runs side by side, in a table like that of the paper.

mod collect;
mod excluded;
mod experiment;
mod order;
mod selected_results;

use std::path::PathBuf;

use crate::exit::{Exit, Failure};
use crate::output::{print_to_stderr, print_to_stdout};
use anyhow::anyhow;
use clap::ValueEnum;
use peernet_analysis::compare::{
    Comparison, Differences, Line, Repeats, SEED, differences_to_best, needs_column,
};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::table::CaptionedTable;
use peernet_statistics::number::counted;

pub(crate) use collect::{CollectedResults, collect, distinct_paths};

/// Arguments of `peernet compare`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Result folders, folders that contain result folders at any depth (such as an experiment), or files data.csv,
    /// including those of the paper's original program.
    #[arg(required = true, value_name = "RUN|DIR")]
    runs: Vec<PathBuf>,
    /// Format of the table.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Write to this file instead of the terminal.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Baseline of the comparison stage by stage: a run's folder or its data.csv, or a folder with several runs of one
    /// configuration, which are pooled [default: the best line, by its mean total; with more than two lines, only the
    /// totals are compared with it]. With --format csv, the table of differences replaces the table of runs.
    #[arg(long, value_name = "RUN")]
    baseline: Option<PathBuf>,
    /// Give each repeat of a configuration a separate line.
    #[arg(long)]
    apart: bool,
    /// Seed of the bootstrap for the intervals of medians: the same seed gives the same numbers.
    #[arg(long, default_value_t = SEED)]
    seed: u64,
}

/// Format of the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// For the terminal, milliseconds.
    Text,
    /// For documents, milliseconds.
    Markdown,
    /// For programs, seconds.
    Csv,
    /// For papers, with booktabs, milliseconds.
    Latex,
}

/// Prints the table and the differences. With two lines or a baseline, the differences are stage by stage. Otherwise
/// they are differences of the totals from the best line.
///
/// # Errors
/// When there are no results (exit code 66), some cannot be read (exit code 65; the others are printed), or the file
/// cannot be written (exit code 73).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let CollectedResults { runs, baseline, notes, unreadable } =
        collect(&arguments.runs, arguments.baseline.as_deref(), &needs_column)?;
    let repeats = match (arguments.apart, baseline.as_slice()) {
        (true, _) => Repeats::Separate,
        (false, []) => Repeats::Pooled,
        (false, runs) => Repeats::PooledExcept(runs),
    };
    let mut comparison = Comparison::with_repeats(&runs, repeats);
    comparison.caveats.extend(notes);
    let baseline_line = if baseline.is_empty() {
        default_baseline(&comparison)
    } else {
        let line = line_of(&comparison, &baseline)?;
        let sentence = baseline_sentence(&comparison.lines[line]);
        if arguments.format == Format::Csv {
            print_to_stderr(&sentence);
        }
        comparison.caveats.push(sentence);
        missing_comparison_reason(&comparison).iter().for_each(print_to_stderr);
        Some(line)
    };
    let differences = differences(&comparison, &runs, baseline_line, arguments.seed);
    let tables = difference_tables(&comparison, &differences);
    let text = match arguments.format {
        Format::Csv if !baseline.is_empty() => Differences::csv(&differences),
        Format::Csv => comparison.csv(),
        Format::Text => join_texts(comparison.text(), tables.iter().map(CaptionedTable::text)),
        Format::Markdown => join_texts(comparison.markdown(), tables.iter().map(CaptionedTable::markdown)),
        Format::Latex => join_texts(comparison.latex(), tables.iter().map(CaptionedTable::latex)),
    };
    let text = text.trim_end();
    let Some(path) = &arguments.out else {
        print_to_stdout(text);
        return unreadable.map_or(Ok(()), Err);
    };
    std::fs::write(path, format!("{text}\n")).map_err(|error| {
        Failure::new(Exit::Unwritten, anyhow!("cannot write {}: {error}", path.display()))
    })?;
    unreadable.map_or(Ok(()), Err)
}

/// Returns the line that has the runs of a baseline.
///
/// # Errors
/// When several lines have runs of the baseline.
fn line_of(comparison: &Comparison, baseline: &[usize]) -> Result<usize, Failure> {
    let has_baseline_run = |line: &Line| line.runs.iter().any(|run| baseline.contains(run));
    let lines: Vec<usize> =
        (0..comparison.lines.len()).filter(|line| has_baseline_run(&comparison.lines[*line])).collect();
    match lines.as_slice() {
        [line] => Ok(*line),
        lines => Err(Failure::new(
            Exit::Usage,
            anyhow!(
                "--baseline: the folder contains {} that have {} lines in the table; give the folder of runs that share one line",
                counted(baseline.len() as u64, "run"),
                lines.len()
            ),
        )),
    }
}

/// Returns a sentence with the name of the baseline and its number of runs.
fn baseline_sentence(line: &Line) -> String {
    let runs = match line.repeats {
        1 => "one run".to_owned(),
        repeats => format!("{}, pooled", counted(repeats as u64, "run")),
    };
    format!("Baseline: {}: {runs}.", line.name)
}

/// Returns the reason why nothing can be compared with the baseline, if there is one.
fn missing_comparison_reason(comparison: &Comparison) -> Option<String> {
    let runs = match comparison.lines.as_slice() {
        [line] => line.runs.len(),
        _ => return None,
    };
    let reason = if runs == 1 { "the baseline is the only run" } else { "all runs belong to the baseline" };
    Some(format!("nothing is compared with the baseline: {reason}"))
}

/// Returns the [default baseline](peernet_analysis::compare::default_baseline) of two lines. `None` for any other number
/// of lines.
pub(crate) fn default_baseline(comparison: &Comparison) -> Option<usize> {
    (comparison.lines.len() == 2).then(|| peernet_analysis::compare::default_baseline(comparison.best))
}

/// Returns the differences of each other line from the baseline, stage by stage.
pub(crate) fn differences(
    comparison: &Comparison,
    runs: &[Loaded],
    baseline_line: Option<usize>,
    seed: u64,
) -> Vec<Differences> {
    let others = |baseline: usize| (0..comparison.lines.len()).filter(move |line| *line != baseline);
    baseline_line
        .into_iter()
        .flat_map(|baseline| others(baseline).map(move |other| (baseline, other)))
        .map(|(baseline, other)| Differences::between_lines(comparison, runs, baseline, other, seed))
        .collect()
}

/// Returns the tables of differences: those of `differences`, or the differences from the best line if `differences`
/// is empty.
pub(crate) fn difference_tables(comparison: &Comparison, differences: &[Differences]) -> Vec<CaptionedTable> {
    if differences.is_empty() {
        return differences_to_best(comparison).into_iter().collect();
    }
    // If one of the two lines has no measurements, there are no stages to compare.
    let with_stages = differences.iter().filter(|differences| !differences.stages.is_empty());
    with_stages.map(Differences::captioned).collect()
}

/// Joins tables to one text.
pub(crate) fn join_texts(first: String, others: impl Iterator<Item = String>) -> String {
    std::iter::once(first)
        .chain(others)
        .map(|text| text.trim_end().to_owned())
        .collect::<Vec<_>>()
        .join("\n\n")
}

#[cfg(test)]
mod tests {
    use peernet_analysis::record::RunRecord;
    use peernet_analysis::rows::Rows;
    use peernet_stream::ExperimentPosition;

    use super::*;

    #[test]
    fn baseline_run_has_separate_line() {
        let run = |repeat: u32| Loaded {
            folder: PathBuf::from(format!("r{repeat}")),
            record: RunRecord {
                experiment: Some(ExperimentPosition {
                    name: "x".to_owned(),
                    id: "x1".to_owned(),
                    configuration: vec![("load".to_owned(), "a".to_owned())],
                    repeat,
                    ..ExperimentPosition::default()
                }),
                ..RunRecord::default()
            },
            rows: Rows::default(),
        };
        let runs = [run(0), run(1), run(2)];
        let describe = |baseline: &[usize]| {
            let comparison = Comparison::with_repeats(&runs, Repeats::PooledExcept(baseline));
            let line = line_of(&comparison, baseline).expect("one line");
            (baseline_sentence(&comparison.lines[line]), missing_comparison_reason(&comparison))
        };
        assert_eq!(describe(&[1]), ("Baseline: repeat 2: one run.".to_owned(), None));
        let (sentence, reason) = describe(&[0, 2]);
        assert_eq!((sentence.as_str(), reason), ("Baseline: 2 repeats: 2 runs, pooled.", None));
        let (sentence, reason) = describe(&[0, 1, 2]);
        assert_eq!(sentence, "Baseline: a: 3 runs, pooled.");
        assert!(reason.expect("no other run is left").contains("all runs belong to the baseline"));
        let apart = Comparison::with_repeats(&runs[..2], Repeats::Separate);
        assert!(line_of(&apart, &[0, 1]).is_err(), "each repeat has a separate line");
        let differences = differences(&apart, &runs, default_baseline(&apart), SEED);
        assert_eq!(
            (differences.len(), difference_tables(&apart, &differences).len()),
            (1, 0),
            "there is no table of lines without measurements"
        );
        let single = missing_comparison_reason(&Comparison::with_repeats(&runs[..1], Repeats::Pooled))
            .expect("there is no run to compare with the baseline");
        assert!(single.contains("the only run"), "{single}");
    }
}
