//! A folder of results.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use peernet_analysis::WriteError;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;

use super::file_names::DATA;
use super::{Finished, FolderError, Overwrite, RowWriter};

/// A folder that results are written to, by this program alone for as long as this is there.
#[derive(Clone, Debug)]
pub struct ResultFolder {
    path: PathBuf,
    /// ColumnKind the lock.
    _lock: Arc<File>,
}

impl ResultFolder {
    /// Makes the folder ready, or another one as `overwrite` says.
    ///
    /// # Errors
    /// Those of [`Self::take`], and when results in it cannot be removed.
    pub fn create(dir: &Path, overwrite: Overwrite) -> Result<Self, FolderError> {
        let folder = Self::take(dir, overwrite)?;
        if overwrite == Overwrite::Replace {
            super::ready::clear(folder.path())?;
        }
        Ok(folder)
    }

    /// Takes the folder, or another one as `overwrite` says, for this program; what is to be replaced is still there.
    ///
    /// # Errors
    /// When another program writes there, it holds something that may not be replaced, is no folder or cannot be made.
    pub fn take(dir: &Path, overwrite: Overwrite) -> Result<Self, FolderError> {
        super::ready::take(dir, overwrite).map(|(path, lock)| Self { path, _lock: Arc::new(lock) })
    }

    /// Names of the files that [`Overwrite::Replace`] takes away from a folder, whether they are there or not.
    pub fn replaced(dir: &Path) -> impl Iterator<Item = String> {
        super::ready::replaced(dir)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Begins `data.csv`: its header is written at once.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn writer(&self) -> Result<RowWriter, FolderError> {
        Ok(RowWriter::begin(self.path.join(DATA))?)
    }

    /// Writes `run.json` and `summary.{md,csv,tex}`, and `data.csv` where it is not whole. When the folder cannot be
    /// written, everything goes to a new folder among the system's temporary files.
    ///
    /// # Errors
    /// When the temporary folder cannot be written either.
    pub fn finish(&self, record: &RunRecord, rows: &Rows) -> Result<Finished, WriteError> {
        super::finish::finish(&self.path, record, rows)
    }

    /// Reads results back: of this program, of older versions, or a published `data.csv` that stands alone. The path
    /// may also be that of a file of rows. A file that was cut off gives the rows that are whole; [`Loaded::damage`] tells.
    ///
    /// # Errors
    /// When there are none or they cannot be read.
    pub fn open(path: &Path) -> Result<Loaded, FolderError> {
        super::read::open(path, &|_| true)
    }

    /// Reads results back as [`Self::open`] does, without the numbers of columns that are not wanted: a long run takes as
    /// much room as what is asked of it.
    ///
    /// # Errors
    /// When there are none or they cannot be read.
    pub fn open_columns(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Loaded, FolderError> {
        super::read::open(path, wanted)
    }

    /// All folders of results in a folder and below, itself included, in the natural order of their names. Links are
    /// not followed, hidden folders not looked into.
    pub fn find(dir: &Path) -> Vec<PathBuf> {
        super::ready::find(dir)
    }
}
