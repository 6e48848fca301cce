//! Figures with the names of their files, and the function that writes the files.

use std::path::{Path, PathBuf};

use super::replayed::contains_model_latency;
use crate::drawing::{
    Cumulative, Histogram, Lengths, Paired, QualityAgainstLatency, Scaling, Sharing, Stacked, TimeSeries,
};
use crate::plot::Figure;
use crate::render::export;
use peernet_analysis::WriteError;

/// Figure that is to be written, with the names of its files and notes on what is left out.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Drawing {
    /// Common beginning of the names of the files: the name without the ending.
    pub(super) stem: String,
    /// Contents of the figure.
    pub(super) figure: AnyFigure,
    /// Notes on runs, directions or configurations that are not in the figure.
    pub(super) left_out: Vec<String>,
}

/// Result of writing figures.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WrittenFigures {
    /// The files, four for each figure: PNG, SVG, PDF and caption.
    pub files: Vec<PathBuf>,
    /// Notes on runs, directions or configurations that are in no figure, with the reasons: `stacked: left out: …`.
    pub left_out: Vec<String>,
}

/// Figure of any kind.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum AnyFigure {
    Histogram(Histogram),
    TimeSeries(TimeSeries),
    Cumulative(Cumulative),
    Lengths(Lengths),
    Stacked(Stacked),
    Paired(Paired),
    Scaling(Scaling),
    QualityAgainstLatency(QualityAgainstLatency),
    Sharing(Sharing),
}

impl Drawing {
    pub(super) fn new(stem: impl Into<String>, figure: AnyFigure) -> Self {
        Self { stem: stem.into(), figure, left_out: Vec::new() }
    }

    /// Returns the same drawing with notes on what is left out of the figure.
    pub(super) fn with_left_out(self, left_out: Vec<String>) -> Self {
        Self { left_out, ..self }
    }

    /// Returns whether the figure shows latencies of a model, or sums that contain them.
    fn shows_model_latency(&self) -> bool {
        match &self.figure {
            AnyFigure::Histogram(histogram) => contains_model_latency(&histogram.stage),
            AnyFigure::Lengths(lengths) => contains_model_latency(&lengths.stage),
            // Upload and download are measured even if the latencies of the model are replayed.
            AnyFigure::Scaling(_) => false,
            AnyFigure::TimeSeries(_)
            | AnyFigure::Cumulative(_)
            | AnyFigure::Stacked(_)
            | AnyFigure::Paired(_)
            | AnyFigure::QualityAgainstLatency(_)
            | AnyFigure::Sharing(_) => true,
        }
    }

    fn layout(&self) -> Figure {
        match &self.figure {
            AnyFigure::Histogram(figure) => figure.figure(),
            AnyFigure::TimeSeries(figure) => figure.figure(),
            AnyFigure::Cumulative(figure) => figure.figure(),
            AnyFigure::Lengths(figure) => figure.figure(),
            AnyFigure::Stacked(figure) => figure.figure(),
            AnyFigure::Paired(figure) => figure.figure(),
            AnyFigure::Scaling(figure) => figure.figure(),
            AnyFigure::QualityAgainstLatency(figure) => figure.figure(),
            AnyFigure::Sharing(figure) => figure.figure(),
        }
    }
}

/// Writes figures into a folder. `replayed_note` is the note on replayed latencies. The note is added to each figure
/// that shows latencies of a model.
pub(super) fn write(
    drawings: &[Drawing],
    replayed_note: Option<&str>,
    folder: &Path,
) -> Result<WrittenFigures, WriteError> {
    // Without figures, no empty folder is created.
    if !drawings.is_empty() {
        std::fs::create_dir_all(folder).map_err(WriteError::at(folder))?;
    }
    let mut written = WrittenFigures::default();
    for drawing in drawings {
        let mut figure = drawing.layout();
        let needed_note = replayed_note.filter(|_| drawing.shows_model_latency());
        figure.notes.extend(needed_note.map(str::to_owned));
        written.files.extend(export::write(&figure, folder, &drawing.stem)?);
        written.left_out.extend(drawing.left_out.iter().map(|note| format!("{}: {note}", drawing.stem)));
    }
    Ok(written)
}
