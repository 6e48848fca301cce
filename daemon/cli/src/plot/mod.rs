//! `peernet plot`: results as figures.

mod figure_folders;

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use crate::output::{print_to_stderr, print_to_stdout};
use anyhow::anyhow;
use clap::ValueEnum;
use peernet_analysis::loaded::Loaded;
use peernet_figures::{self as figures, Columns, PlotError};
use peernet_statistics::number::counted;

use crate::compare::{CollectedResults, collect, distinct_paths};
use figure_folders::FigureFolders;

/// Arguments of `peernet plot`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Result folders, folders that contain result folders at any depth (such as an experiment), or files data.csv,
    /// including those of the paper's original program.
    #[arg(required = true, value_name = "RUN|DIR")]
    runs: Vec<PathBuf>,
    /// Figures to draw.
    #[arg(long, value_enum, default_value_t = Kind::All)]
    kind: Kind,
    /// Folder for the figures. With several runs, each run gets a subfolder [default: figures of one run in the
    /// run's folder, or in a subfolder if several files of the folder are given; figures of several runs in the folder
    /// on the command line, or in the current folder if several folders are given].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Column of data.csv, or name of a node (output-chunks), on the horizontal axis. For --kind length: the length
    /// [default: tokens, or download-bytes without tokens]. For --kind histograms and --kind cumulative: the only
    /// column to draw.
    #[arg(long, value_name = "COLUMN")]
    x: Option<String>,
    /// Column of data.csv, or name of a node, on the vertical axis, for --kind length and --kind paired: a latency
    /// [default: inference].
    #[arg(long, value_name = "COLUMN")]
    y: Option<String>,
}

/// Kinds of figures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// All kinds for which there is data.
    All,
    /// For each run: the six histograms of the paper's program, sensing-time to download-throughput.
    Histograms,
    /// For each run: the share of iterations up to each latency, of the total and its longest stages.
    Cumulative,
    /// For all runs: a bar of stacked stages for each configuration.
    Stacked,
    /// For all runs: the share of iterations up to each total, a curve for each configuration.
    Totals,
    /// For all runs: top-1 accuracy, mAP@0.5 or mean IoU, and success and return of episodes, of each configuration
    /// against its latency.
    Accuracy,
    /// For all runs: inference of each model on board and in the cloud.
    Paired,
    /// For all runs: latency and throughput against payload, with fit and intercept.
    Payload,
    /// For all runs: latency and fairness against the number of edges that share one cloud.
    Users,
    /// For each run: response length against latency.
    Length,
    /// For each run: total and stages over time.
    Series,
}

impl Kind {
    fn figures(self) -> Vec<figures::Kind> {
        match self {
            Self::All => figures::Kind::ALL.to_vec(),
            Self::Histograms => vec![figures::Kind::Histograms],
            Self::Cumulative => vec![figures::Kind::Cumulative],
            Self::Stacked => vec![figures::Kind::Stacked],
            Self::Totals => vec![figures::Kind::Totals],
            Self::Accuracy => vec![figures::Kind::Accuracy],
            Self::Paired => vec![figures::Kind::Paired],
            Self::Payload => vec![figures::Kind::Payload],
            Self::Users => vec![figures::Kind::Users],
            Self::Length => vec![figures::Kind::Length],
            Self::Series => vec![figures::Kind::Series],
        }
    }
}

/// Draws the figures and prints their paths.
///
/// # Errors
/// When there are no results (exit code 66), some cannot be read (the others are drawn) or they lack what the kind
/// shows (exit code 65), an option has no meaning for the kind (exit code 64), or a file cannot be written (exit code
/// 73).
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    check(arguments)?;
    let named_paths = distinct_paths(&arguments.runs);
    let (no_baseline, is_wanted_column) = (None, |_: &str| true);
    let CollectedResults { runs, unreadable, .. } = collect(&named_paths, no_baseline, &is_wanted_column)?;
    let folders = FigureFolders::choose(&named_paths, &runs, arguments.out.as_deref());
    let columns = Columns { x: arguments.x.clone(), y: arguments.y.clone() };
    let mut missing_data = Vec::new();
    let mut files = Vec::new();
    let mut draw_kind = |kind: figures::Kind, runs: &[Loaded], folder: &Path| -> Result<(), Failure> {
        match figures::draw(kind, runs, &columns, folder) {
            Ok(written) => {
                written.left_out.iter().for_each(print_to_stderr);
                files.extend(written.files);
            }
            Err(error @ PlotError::MissingData(..)) => missing_data.push((folder.to_owned(), error)),
            Err(error) => return Err(Failure::new(Exit::Unwritten, error)),
        }
        Ok(())
    };
    for kind in arguments.kind.figures() {
        if kind.is_of_one_run() {
            for (run, folder) in runs.iter().zip(&folders.runs) {
                draw_kind(kind, std::slice::from_ref(run), folder)?;
            }
        } else if arguments.kind != Kind::All || kind.is_worth_drawing(&runs) {
            draw_kind(kind, &runs, &folders.all_runs)?;
        }
    }
    if arguments.kind == Kind::All {
        // Without --kind, only figures that every result can show are reported as missing.
        missing_data
            .retain(|(_, error)| matches!(error, PlotError::MissingData(kind, _) if kind.is_expected()));
    } else if let (true, Some(reasons)) = (files.is_empty(), reasons(&missing_data)) {
        // A single kind that cannot be drawn is a failure.
        return Err(Failure::new(Exit::Data, anyhow!("{reasons}")));
    }
    missing_data
        .iter()
        .for_each(|(folder, error)| print_to_stderr(format_args!("{}: {error}", folder.display())));
    files.iter().for_each(|file| print_to_stdout(file.display()));
    unreadable.map_or(Ok(()), Err)
}

/// Describes the reasons why nothing was drawn, each once with its number of runs. A single reason has no number.
/// `None` if there is no reason.
fn reasons(missing_data: &[(PathBuf, PlotError)]) -> Option<String> {
    let mut reasons: Vec<(String, usize)> = Vec::new();
    for (_, error) in missing_data {
        let reason = error.to_string();
        match reasons.iter_mut().find(|(other, _)| *other == reason) {
            Some((_, count)) => *count += 1,
            None => reasons.push((reason, 1)),
        }
    }
    if let [(reason, _)] = reasons.as_slice() {
        return Some(reason.clone());
    }
    let descriptions =
        reasons.iter().map(|(reason, count)| format!("{}: {reason}", counted(*count as u64, "run")));
    (!reasons.is_empty()).then(|| descriptions.collect::<Vec<_>>().join("; "))
}

/// Checks that the kind of figure uses the given options.
fn check(arguments: &Arguments) -> Result<(), Failure> {
    let usage = |text: &str| Err(Failure::new(Exit::Usage, anyhow!("{text}")));
    match arguments.kind {
        Kind::Length => Ok(()),
        Kind::Paired if arguments.x.is_none() => Ok(()),
        Kind::Histograms | Kind::Cumulative if arguments.y.is_none() => Ok(()),
        _ if arguments.x.is_none() && arguments.y.is_none() => Ok(()),
        _ => usage(
            "--x is for --kind length, histograms and cumulative, --y for --kind length and paired: use one of these kinds",
        ),
    }
}

#[cfg(test)]
mod tests {
    use peernet_figures::MissingData;

    use super::*;

    #[test]
    fn no_folder_is_created_without_figures() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("data.csv"), "iteration,sensing\n1,0.5\n2,0.5\n")
            .expect("writable");
        let out = folder.path().join("out");
        for kind in [Kind::Accuracy, Kind::Payload, Kind::Users, Kind::Length] {
            let runs = vec![folder.path().to_owned()];
            let failure = run(&Arguments { runs, kind, out: Some(out.clone()), x: None, y: None });
            assert_eq!(failure.map_err(|failure| failure.exit), Err(Exit::Data), "{kind:?}");
            assert!(!out.exists(), "{kind:?}");
        }
    }

    #[test]
    fn each_reason_is_reported_once() {
        let lacking = |reasons: &[MissingData]| -> Vec<(PathBuf, PlotError)> {
            let error = |reason: &MissingData| PlotError::MissingData(figures::Kind::Length, reason.clone());
            reasons.iter().map(|reason| (PathBuf::new(), error(reason))).collect()
        };
        let (runs, total) = (MissingData::Runs, MissingData::Total);
        assert_eq!(reasons(&[]), None);
        let twice = lacking(&[runs.clone(), runs.clone()]);
        assert_eq!(reasons(&twice).as_deref(), Some("cannot draw length: there is no run"));
        assert_eq!(
            reasons(&lacking(&[runs, total.clone(), total])).as_deref(),
            Some(
                "1 run: cannot draw length: there is no run; 2 runs: cannot draw length: no successful iteration \
                 has a total that can be drawn"
            )
        );
    }
}
