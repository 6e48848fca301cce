//! Folder with the results of a run.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use peernet_analysis::WriteError;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;

use super::file_names::DATA;
use super::{FolderError, Overwrite, RowWriter, WrittenResults};

/// Folder for results. As long as this value exists, only this program writes to the folder.
#[derive(Clone, Debug)]
pub struct ResultFolder {
    path: PathBuf,
    /// The opened folder, which holds the lock.
    _lock: Arc<File>,
}

impl ResultFolder {
    /// Prepares the folder, or a new subfolder if `overwrite` says so. [`Overwrite::Replace`] removes earlier results.
    ///
    /// # Errors
    /// The errors of [`Self::acquire`], and an error if results in the folder cannot be removed.
    pub fn create(dir: &Path, overwrite: Overwrite) -> Result<Self, FolderError> {
        let folder = Self::acquire(dir, overwrite)?;
        if overwrite == Overwrite::Replace {
            super::preparation::clear(folder.path())?;
        }
        Ok(folder)
    }

    /// Locks the folder, or a new subfolder if `overwrite` says so, for this program. Files that are to be replaced are
    /// not removed yet.
    ///
    /// # Errors
    /// If another program writes to the folder, or if it contains files that must not be replaced, is not a folder or
    /// cannot be created.
    pub fn acquire(dir: &Path, overwrite: Overwrite) -> Result<Self, FolderError> {
        super::preparation::acquire(dir, overwrite).map(|(path, lock)| Self { path, _lock: Arc::new(lock) })
    }

    /// Returns the names of the files that [`Overwrite::Replace`] removes from a folder, whether they exist or not.
    pub fn replaced_files(dir: &Path) -> impl Iterator<Item = String> {
        super::preparation::replaced_files(dir)
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Creates `data.csv`, replacing an existing file, and writes its header.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn create_writer(&self) -> Result<RowWriter, FolderError> {
        Ok(RowWriter::create(self.path.join(DATA))?)
    }

    /// Writes `run.json` and `summary.{md,csv,tex}`, and `data.csv` if it is incomplete. If the folder cannot be
    /// written, all files go to a new folder among the system's temporary files.
    ///
    /// # Errors
    /// If the temporary folder cannot be written either.
    pub fn finish(&self, record: &RunRecord, rows: &Rows) -> Result<WrittenResults, WriteError> {
        super::finish::finish(&self.path, record, rows)
    }

    /// Reads results of this program or of its older versions, or a single `data.csv` of the paper's original
    /// program. The path is a folder or a file of rows. A truncated file yields its complete rows; [`Loaded::damage`]
    /// reports that rows are missing.
    ///
    /// # Errors
    /// If there are no results or they cannot be read.
    pub fn open(path: &Path) -> Result<Loaded, FolderError> {
        super::read::open(path, &|_| true)
    }

    /// Reads results as [`Self::open`] does, but stores only the numbers of the wanted columns. This saves memory
    /// with long runs.
    ///
    /// # Errors
    /// If there are no results or they cannot be read.
    pub fn open_columns(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Loaded, FolderError> {
        super::read::open(path, wanted)
    }

    /// Returns all result folders below a folder, and the folder itself if it is one, in the natural order of their
    /// names (`run-2` before `run-10`). Links are not followed, and hidden folders are skipped.
    pub fn find(dir: &Path) -> Vec<PathBuf> {
        super::preparation::find(dir)
    }
}
