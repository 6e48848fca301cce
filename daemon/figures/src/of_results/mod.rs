//! Figures of results: the kinds that a run or an experiment has, and the names of their files.
//!
//! ```text
//! Loaded ─┬─ histograms, cumulative, length, series              one run
//!         └─ stacked, totals, accuracy, paired, payload, users   all runs together
//! ```
//!
//! [`crate::drawing`] defines the layout of each kind.

mod accuracy;
mod columns;
mod configuration_groups;
mod cumulative;
mod histograms;
mod length;
mod longest_stages;
mod missing_data;
mod paired;
mod payload;
mod replayed;
mod series;
mod stacked;
mod totals;
mod users;
mod written_figures;

pub use missing_data::MissingData;
pub use written_figures::WrittenFigures;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use peernet_analysis::WriteError;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;

/// Kind of figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The six histograms of the paper's original program.
    Histograms,
    /// Share of iterations up to each latency, for the total and the longest stages.
    Cumulative,
    /// The total and the longest stages over time.
    Series,
    /// Latency against the length of answers.
    Length,
    /// Stacked stages of each configuration.
    Stacked,
    /// Share of iterations up to each total, for each configuration.
    Totals,
    /// Accuracy, or another quality, of each configuration against its latency.
    Accuracy,
    /// Latency of a model on the robot and in the cloud.
    Paired,
    /// Latency and throughput against payload.
    Payload,
    /// Latency against the number of edges that use the cloud at the same time.
    Users,
}

impl Kind {
    /// All kinds: first the kinds that are drawn for each run separately, then the kinds that are drawn for all runs
    /// together.
    pub const ALL: [Self; 10] = [
        Self::Histograms,
        Self::Cumulative,
        Self::Series,
        Self::Length,
        Self::Stacked,
        Self::Totals,
        Self::Accuracy,
        Self::Paired,
        Self::Payload,
        Self::Users,
    ];

    /// Returns the name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Histograms => "histograms",
            Self::Cumulative => "cumulative",
            Self::Series => "series",
            Self::Length => "length",
            Self::Stacked => "stacked",
            Self::Totals => "totals",
            Self::Accuracy => "accuracy",
            Self::Paired => "paired",
            Self::Payload => "payload",
            Self::Users => "users",
        }
    }

    /// Returns whether the figure is drawn for each run separately.
    pub const fn is_of_one_run(self) -> bool {
        matches!(self, Self::Histograms | Self::Cumulative | Self::Series | Self::Length)
    }

    /// Returns whether all results should have the data for the figure. If a person requests all figures, only the
    /// absence of an expected figure is reported.
    pub const fn is_expected(self) -> bool {
        matches!(self, Self::Series | Self::Stacked)
    }

    /// Returns whether a figure of these runs is drawn even if this kind is not requested. A figure that compares
    /// configurations is then drawn only for at least two configurations.
    pub fn is_worth_drawing(self, runs: &[Loaded]) -> bool {
        match self {
            Self::Stacked | Self::Totals | Self::Accuracy => {
                configuration_groups::ConfigurationGroups::from_runs(runs).groups.len() > 1
            }
            Self::Paired => runs.len() > 1,
            Self::Users => users::have_curves(runs),
            Self::Histograms | Self::Cumulative | Self::Series | Self::Length | Self::Payload => {
                !runs.is_empty()
            }
        }
    }
}

/// Columns that a figure shows instead of its default columns. Each column is given by its name or by the name of its
/// node ([`Rows::columns_named`]); `None` stands for the default column.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Columns {
    /// Column of the horizontal axis: the quantity of a histogram or of a cumulative distribution, or the length of an
    /// answer.
    pub x: Option<String>,
    /// Column of the vertical axis: a latency.
    pub y: Option<String>,
}

impl Columns {
    /// Replaces the names of nodes by the names of their columns in `data.csv`. A name that no run has is kept. The
    /// figure then reports that the column has no numbers.
    fn resolve(&self, runs: &[Loaded]) -> Result<Self, MissingData> {
        let resolve = |name: &Option<String>| {
            let Some(name) = name else { return Ok(None) };
            let columns: BTreeSet<&str> = runs.iter().flat_map(|run| run.rows.columns_named(name)).collect();
            let mut columns: Vec<String> = columns.into_iter().map(str::to_owned).collect();
            // If a run has a column with exactly this name, the name is not ambiguous, even if the
            // column of another run has a longer name.
            if columns.len() > 1 && !columns.contains(name) {
                return Err(MissingData::AmbiguousColumn { name: name.clone(), columns });
            }
            Ok(Some(if columns.len() == 1 { columns.swap_remove(0) } else { name.clone() }))
        };
        Ok(Self { x: resolve(&self.x)?, y: resolve(&self.y)? })
    }
}

/// Error of a figure that was not drawn.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// The results lack the data for figures of this kind.
    #[error("cannot draw {kind}: {missing}", kind = .0.name(), missing = .1)]
    MissingData(Kind, #[source] MissingData),
    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Draws the figures of a run into a folder: the six histograms of the paper's original program (`sensing-time` to
/// `download-throughput`), `cumulative`, `series` and, for a language model, `length`. Each figure is written as
/// `.png`, `.svg` and `.pdf`, and its notes as `-caption.txt`. Returns the paths of the files.
///
/// A run that sent nothing over a network has the histograms of sensing and inference only. A histogram without values
/// shows the text `no values`. A run without any total has neither `cumulative` nor `series`.
///
/// # Errors
/// If a file cannot be written.
pub fn of_run(record: &RunRecord, rows: &Rows, folder: &Path) -> Result<Vec<PathBuf>, WriteError> {
    let mut drawings = histograms::original_histograms(record, rows);
    // A figure for which the run lacks the data is left out.
    drawings.extend(cumulative::drawings(record, rows, None).unwrap_or_default());
    drawings.extend(series::drawings(record, rows).unwrap_or_default());
    if length::has_tokens(rows) {
        drawings.extend(length::drawings(record, rows, &Columns::default()).unwrap_or_default());
    }
    Ok(written_figures::write(&drawings, replayed::note_of_run(record, rows).as_deref(), folder)?.files)
}

/// Draws the figures of several runs together: `stacked`, `totals` and `accuracy` of several configurations, `paired`,
/// `payload-latency` and `payload-throughput`, `users`. Figures for which the runs lack the data are left out. Returns
/// the paths of the files.
///
/// # Errors
/// If a file cannot be written.
pub fn of_experiment(runs: &[Loaded], folder: &Path) -> Result<Vec<PathBuf>, WriteError> {
    let mut files = Vec::new();
    let kinds = Kind::ALL.into_iter().filter(|kind| !kind.is_of_one_run() && kind.is_worth_drawing(runs));
    for kind in kinds {
        match draw(kind, runs, &Columns::default(), folder) {
            Ok(written) => files.extend(written.files),
            Err(PlotError::Write(error)) => return Err(error),
            Err(PlotError::MissingData(..)) => {}
        }
    }
    Ok(files)
}

/// Draws the figures of one kind into a folder. A kind that [is of one run](Kind::is_of_one_run) shows the first of
/// `runs`. Other kinds show all runs together. The folder is created if there is something to draw. Returns the paths
/// of the files, and notes on data that the figures do not show.
///
/// # Errors
/// If the runs lack the data that the kind shows, or a file cannot be written.
pub fn draw(
    kind: Kind,
    runs: &[Loaded],
    columns: &Columns,
    folder: &Path,
) -> Result<WrittenFigures, PlotError> {
    let first = runs.first().ok_or(PlotError::MissingData(kind, MissingData::Runs))?;
    let shown_runs = if kind.is_of_one_run() { std::slice::from_ref(first) } else { runs };
    let columns = &columns.resolve(shown_runs).map_err(|missing| PlotError::MissingData(kind, missing))?;
    let drawings = match kind {
        Kind::Histograms => histograms::drawings(first, columns.x.as_deref()),
        Kind::Cumulative => cumulative::drawings(&first.record, &first.rows, columns.x.as_deref()),
        Kind::Series => series::drawings(&first.record, &first.rows),
        Kind::Length => length::drawings(&first.record, &first.rows, columns),
        Kind::Stacked => stacked::drawings(runs),
        Kind::Totals => totals::drawings(runs),
        Kind::Accuracy => accuracy::drawings(runs),
        Kind::Paired => paired::drawings(runs, columns.y.as_deref()),
        Kind::Payload => payload::drawings(runs),
        Kind::Users => users::drawings(runs),
    };
    let drawings = drawings.map_err(|missing| PlotError::MissingData(kind, missing))?;
    let replayed_note = if kind.is_of_one_run() {
        replayed::note_of_run(&first.record, &first.rows)
    } else {
        replayed::note(runs)
    };
    Ok(written_figures::write(&drawings, replayed_note.as_deref(), folder)?)
}

#[cfg(test)]
mod tests;
