//! Figures on their way into files.

use std::path::{Path, PathBuf};

use crate::drawing::{Accuracy, Course, Figure, Histogram, Lengths, Paired, Scaling, Sharing, Stacked};
use peernet_analysis::WriteError;

/// A figure and the name of its files.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Drawing {
    pub(super) stem: String,
    pub(super) shown: Shown,
    /// What whole parts of the results are not in it.
    pub(super) missing: Vec<String>,
}

/// Figures that were written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// The files, two for each figure.
    pub files: Vec<PathBuf>,
    /// Which whole parts of the results are in none of them, and why, as in their notes: `stacked: left out: …`.
    pub missing: Vec<String>,
}

/// Any figure.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Shown {
    Histogram(Histogram),
    Course(Course),
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

    fn write(&self, folder: &Path) -> Result<[PathBuf; 2], WriteError> {
        match &self.shown {
            Shown::Histogram(figure) => figure.write(folder, &self.stem),
            Shown::Course(figure) => figure.write(folder, &self.stem),
            Shown::Lengths(figure) => figure.write(folder, &self.stem),
            Shown::Stacked(figure) => figure.write(folder, &self.stem),
            Shown::Paired(figure) => figure.write(folder, &self.stem),
            Shown::Scaling(figure) => figure.write(folder, &self.stem),
            Shown::Accuracy(figure) => figure.write(folder, &self.stem),
            Shown::Sharing(figure) => figure.write(folder, &self.stem),
        }
    }
}

pub(super) fn write(drawings: &[Drawing], folder: &Path) -> Result<Written, WriteError> {
    if !drawings.is_empty() {
        std::fs::create_dir_all(folder).map_err(WriteError::at(folder))?;
    }
    let mut written = Written::default();
    for drawing in drawings {
        written.files.extend(drawing.write(folder)?);
        written.missing.extend(drawing.missing.iter().map(|missing| format!("{}: {missing}", drawing.stem)));
    }
    Ok(written)
}
