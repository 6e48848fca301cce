//! Figures on their way into files.

use std::path::{Path, PathBuf};

use crate::WriteError;
use crate::figure::{Accuracy, Course, Figure, Histogram, Lengths, Paired, Scaling, Sharing, Stacked};

/// A figure and the name of its files.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Drawing {
    pub(super) stem: String,
    pub(super) shown: Shown,
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
        Self { stem: stem.into(), shown }
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

pub(super) fn write(drawings: &[Drawing], folder: &Path) -> Result<Vec<PathBuf>, WriteError> {
    let mut files = Vec::new();
    for drawing in drawings {
        files.extend(drawing.write(folder)?);
    }
    Ok(files)
}
