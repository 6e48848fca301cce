//! `peernet compare`: runs side by side, as the paper's table.

mod collect;
mod copies;
mod experiment;
mod order;
mod undone;

use std::path::PathBuf;

use crate::exit::{Exit, Failure};
use crate::output::{complain, say};
use anyhow::anyhow;
use clap::ValueEnum;
use peernet_analysis::compare::{Comparison, Differences, Repeats, SEED, against_best, is_compared};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::table::Captioned;

pub(crate) use collect::{Collected, collect, distinct};

/// What `peernet compare` can be told.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folders of results; folders that hold some, at any depth, such as an experiment's; or files of rows (data.csv),
    /// those of the published program as well.
    #[arg(required = true, value_name = "RUN|DIR")]
    runs: Vec<PathBuf>,
    /// How the table is written.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Write to this file instead of the terminal.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// What the others are compared with, stage by stage: the folder of a run, or its file of rows [default: of two lines
    /// the first; of more the best, without the stages]. With --format csv the table of differences takes the place of the
    /// other one.
    #[arg(long, value_name = "RUN")]
    baseline: Option<PathBuf>,
    /// Give each repeat of a configuration a line of its own.
    #[arg(long)]
    apart: bool,
    /// Seed of the bootstrap that the intervals of medians rest on: the same seed gives the same figures.
    #[arg(long, default_value_t = SEED)]
    seed: u64,
}

/// How tables are written.
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

/// Prints the table, and the differences: of two lines or from a baseline stage by stage, else from the best line.
///
/// # Errors
/// When there are no results (66), they cannot be read (65), or the file cannot be written (73).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Collected { runs, baseline, left_out } =
        collect(&arguments.runs, arguments.baseline.as_deref(), &is_compared)?;
    let repeats = if arguments.apart { Repeats::Apart } else { Repeats::Pooled };
    let mut comparison = Comparison::with(&runs, repeats);
    comparison.doubts.extend(left_out);
    let line_of = |run: usize| comparison.lines.iter().position(|line| line.runs.contains(&run));
    let first = match baseline {
        Some(run) => line_of(run),
        None => first_of_two(&comparison),
    };
    if baseline.is_some() {
        alone(&comparison).iter().for_each(complain);
    }
    let differences = differences(&comparison, &runs, first, arguments.seed);
    let tables = below(&comparison, &differences);
    let text = match arguments.format {
        Format::Csv if baseline.is_some() => Differences::csv(&differences),
        Format::Csv => comparison.csv(),
        Format::Text => joined(comparison.text(), tables.iter().map(Captioned::text)),
        Format::Markdown => joined(comparison.markdown(), tables.iter().map(Captioned::markdown)),
        Format::Latex => joined(comparison.latex(), tables.iter().map(Captioned::latex)),
    };
    let text = text.trim_end();
    let Some(path) = &arguments.out else {
        say(text);
        return Ok(());
    };
    std::fs::write(path, format!("{text}\n"))
        .map_err(|error| Failure::new(Exit::Unwritten, anyhow!("cannot write {}: {error}", path.display())))
}

/// Why nothing can be compared with a baseline, if that is so.
fn alone(comparison: &Comparison) -> Option<String> {
    let runs = match comparison.lines.as_slice() {
        [line] => line.runs.len(),
        _ => return None,
    };
    let (why, so) = if runs == 1 {
        ("it is the only run", "")
    } else {
        ("all runs are of one configuration and stand in one line", "; --apart gives each repeat its own")
    };
    Some(format!("nothing is compared with the baseline: {why}{so}"))
}

/// The line that the other one is compared with where nobody said which.
pub(crate) fn first_of_two(comparison: &Comparison) -> Option<usize> {
    (comparison.lines.len() == 2).then_some(0)
}

/// Each other line against the first, stage by stage.
pub(crate) fn differences(
    comparison: &Comparison,
    runs: &[Loaded],
    first: Option<usize>,
    seed: u64,
) -> Vec<Differences> {
    let others = |first: usize| (0..comparison.lines.len()).filter(move |line| *line != first);
    first
        .into_iter()
        .flat_map(|first| others(first).map(move |other| (first, other)))
        .map(|(first, other)| Differences::of_lines(comparison, runs, first, other, seed))
        .collect()
}

/// The tables that stand below the paper's: these differences, or, without them, those from the best line.
pub(crate) fn below(comparison: &Comparison, differences: &[Differences]) -> Vec<Captioned> {
    if differences.is_empty() {
        return against_best(comparison).into_iter().collect();
    }
    // Nothing is compared with a line that measured nothing.
    let told = differences.iter().filter(|differences| !differences.stages.is_empty());
    told.map(Differences::captioned).collect()
}

/// Tables in one text.
pub(crate) fn joined(first: String, others: impl Iterator<Item = String>) -> String {
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
    use peernet_stream::ExperimentPlace;

    use super::*;

    #[test]
    fn a_baseline_that_nothing_is_compared_with_is_told() {
        let run = |repeat: u32| Loaded {
            folder: PathBuf::from(format!("r{repeat}")),
            record: RunRecord {
                experiment: Some(ExperimentPlace {
                    name: "x".to_owned(),
                    id: "x1".to_owned(),
                    configuration: vec![("load".to_owned(), "a".to_owned())],
                    repeat,
                }),
                ..RunRecord::default()
            },
            rows: Rows::default(),
        };
        let runs = [run(1), run(2)];
        let told = |runs: &[Loaded], repeats| alone(&Comparison::with(runs, repeats));
        let pooled = told(&runs, Repeats::Pooled).expect("they are one line");
        assert!(pooled.contains("one configuration") && pooled.contains("--apart"), "{pooled}");
        assert_eq!(told(&runs, Repeats::Apart), None);
        let apart = Comparison::with(&runs, Repeats::Apart);
        let differences = differences(&apart, &runs, first_of_two(&apart), SEED);
        assert_eq!((differences.len(), below(&apart, &differences).len()), (1, 0), "no table without a line");
        let single = told(&runs[..1], Repeats::Pooled).expect("there is no other");
        assert!(single.contains("the only run") && !single.contains("--apart"), "{single}");
    }
}
