//! `peernet compare`: runs side by side, as the paper's table.

mod collect;
mod order;

use std::path::PathBuf;

use anyhow::anyhow;
use clap::ValueEnum;
use peernet_report::compare::{Comparison, Differences, Repeats, SEED, is_compared};
use peernetd::exit::{Exit, Failure};
use peernetd::output::say;

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
    /// What the others are compared with, stage by stage: one of the runs. With two lines in the table this is the first
    /// of them. With --format csv the table of differences takes the place of the other one.
    #[arg(long, value_name = "RUN")]
    baseline: Option<PathBuf>,
    /// Give each repeat of a configuration a line of its own.
    #[arg(long)]
    apart: bool,
    /// Seed of the bootstrap that intervals and ties rest on: the same seed gives the same figures.
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

/// Prints the table, and the differences where there are two lines or a baseline.
///
/// # Errors
/// When there are no results (66), they cannot be read (65), or the file cannot be written (73).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Collected { runs, baseline } = collect(&arguments.runs, arguments.baseline.as_deref(), &is_compared)?;
    let repeats = if arguments.apart { Repeats::Apart } else { Repeats::Pooled };
    let comparison = Comparison::with(&runs, repeats, arguments.seed);
    let line_of = |run: usize| comparison.lines.iter().position(|line| line.runs.contains(&run));
    let first = match baseline {
        Some(run) => line_of(run),
        None => (comparison.lines.len() == 2).then_some(0),
    };
    let others = |first: usize| (0..comparison.lines.len()).filter(move |line| *line != first);
    let differences: Vec<Differences> = first
        .into_iter()
        .flat_map(|first| others(first).map(move |other| (first, other)))
        .map(|(first, other)| Differences::of_lines(&comparison, &runs, first, other, arguments.seed))
        .collect();
    let text = match arguments.format {
        Format::Csv if baseline.is_some() => Differences::csv(&differences),
        Format::Csv => comparison.csv(),
        Format::Text => joined(comparison.text(), differences.iter().map(Differences::text)),
        Format::Markdown => joined(comparison.markdown(), differences.iter().map(Differences::markdown)),
        Format::Latex => joined(comparison.latex(), differences.iter().map(Differences::latex)),
    };
    let text = text.trim_end();
    let Some(path) = &arguments.out else {
        say(text);
        return Ok(());
    };
    std::fs::write(path, format!("{text}\n"))
        .map_err(|error| Failure::new(Exit::Unwritten, anyhow!("cannot write {}: {error}", path.display())))
}

fn joined(first: String, others: impl Iterator<Item = String>) -> String {
    std::iter::once(first)
        .chain(others)
        .map(|text| text.trim_end().to_owned())
        .collect::<Vec<_>>()
        .join("\n\n")
}
