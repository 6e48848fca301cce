//! Figures on their way into files.

use std::path::{Path, PathBuf};

use crate::drawing::{Accuracy, Course, Cumulative, Histogram, Lengths, Paired, Scaling, Sharing, Stacked};
use crate::plot::Figure;
use crate::sheet::export;
use peernet_analysis::WriteError;

/// Figure with the name of its files.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Drawing {
    pub(super) stem: String,
    pub(super) shown: Shown,
    /// Notes on whole parts of the results that are not in it.
    pub(super) missing: Vec<String>,
}

/// Figures that were written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// The files, four for each figure: PNG, SVG, PDF and its text.
    pub files: Vec<PathBuf>,
    /// Notes on runs, directions or configurations that are in no figure, with the reasons: `stacked: left out: …`.
    pub missing: Vec<String>,
}

/// Figure of any kind.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Shown {
    Histogram(Histogram),
    Course(Course),
    Cumulative(Cumulative),
    Lengths(Lengths),
    Stacked(Stacked),
    Paired(Paired),
    Scaling(Scaling),
    Accuracy(Accuracy),
    Sharing(Sharing),
}

impl Drawing {
    pub(super) fn new(stem: impl Into<String>, shown: Shown) -> Self {
        Self { stem: stem.into(), shown, missing: Vec::new() }
    }

    pub(super) fn without(self, missing: Vec<String>) -> Self {
        Self { missing, ..self }
    }

    fn figure(&self) -> Figure {
        match &self.shown {
            Shown::Histogram(shown) => shown.figure(),
            Shown::Course(shown) => shown.figure(),
            Shown::Cumulative(shown) => shown.figure(),
            Shown::Lengths(shown) => shown.figure(),
            Shown::Stacked(shown) => shown.figure(),
            Shown::Paired(shown) => shown.figure(),
            Shown::Scaling(shown) => shown.figure(),
            Shown::Accuracy(shown) => shown.figure(),
            Shown::Sharing(shown) => shown.figure(),
        }
    }
}

pub(super) fn write(drawings: &[Drawing], folder: &Path) -> Result<Written, WriteError> {
    if !drawings.is_empty() {
        std::fs::create_dir_all(folder).map_err(WriteError::at(folder))?;
    }
    let mut written = Written::default();
    for drawing in drawings {
        written.files.extend(export::write(&drawing.figure(), folder, &drawing.stem)?);
        written.missing.extend(drawing.missing.iter().map(|missing| format!("{}: {missing}", drawing.stem)));
    }
    Ok(written)
}
