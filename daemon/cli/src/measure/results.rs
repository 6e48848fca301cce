//! Folder of a run's results.

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;
use peernet_results::{DATA, FolderError, Overwrite, ResultFolder, RowWriter, WrittenResults};

use super::RunRequest;
use super::previous_results::PreviousResultsGuard;

/// A folder that exists and is known to be writable before anything is measured.
pub(super) struct Results {
    /// Earlier results to be replaced.
    // This field is declared before `folder`, so that it is dropped first: the earlier results are restored before the
    // lock is released and other programs may use the folder.
    previous_results: Option<PreviousResultsGuard>,
    folder: ResultFolder,
    /// `true` if the folder was created for this run.
    is_created: bool,
}

/// Written results of a run.
pub(super) struct WrittenFiles {
    pub(super) folder: PathBuf,
    pub(super) files: Vec<PathBuf>,
    /// Reason why the results are not in the requested folder, and the path to them.
    pub(super) trouble: Option<String>,
}

impl Results {
    /// Creates and locks the folder that the request names.
    ///
    /// # Errors
    /// When the folder holds results that must not be replaced (exit code 64), another program writes there (exit code
    /// 69), or the folder cannot be created (exit code 73).
    pub(super) fn prepare(request: &RunRequest) -> Result<Self, Failure> {
        // Previous results are restored only if the folder can be locked, which shows that no run is active there.
        if PreviousResultsGuard::has_leftovers(&request.folder)
            && let Ok(folder) = ResultFolder::acquire(&request.folder, Overwrite::Replace)
        {
            PreviousResultsGuard::recover(folder.path())?;
        }
        let was_there = request.folder.exists();
        let folder = ResultFolder::acquire(&request.folder, request.overwrite).map_err(failure)?;
        let replaces = was_there && request.overwrite == Overwrite::Replace;
        let previous_results =
            replaces.then(|| PreviousResultsGuard::move_away(folder.path())).transpose()?;
        // With `Overwrite::Subfolder`, the folder may be a new subfolder of the requested folder.
        let is_created = !was_there || folder.path() != request.folder;
        Ok(Self { folder, is_created, previous_results })
    }

    /// Returns the path of the folder.
    pub(super) fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Creates the file of the rows and returns its writer.
    ///
    /// # Errors
    /// When the file cannot be written (exit code 73).
    pub(super) fn create_writer(&self) -> Result<RowWriter, Failure> {
        self.folder.create_writer().map_err(failure)
    }

    /// Removes everything that was created for the run, because nothing was measured. Earlier results are restored.
    pub(super) fn discard(self) {
        // A file that remains does no harm.
        let _ = std::fs::remove_file(self.path().join(DATA));
        if self.is_created {
            let _ = std::fs::remove_dir(self.path());
        }
        drop(self.previous_results);
    }

    /// Writes all results, to another folder if necessary.
    pub(super) fn finish(&mut self, record: &RunRecord, rows: &Rows) -> WrittenFiles {
        let mut previous_results = self.previous_results.take();
        match self.folder.finish(record, rows) {
            Ok(WrittenResults { folder, files, write_error: None }) => {
                if let Some(previous_results) = &mut previous_results {
                    previous_results.remove();
                }
                WrittenFiles { folder, files, trouble: None }
            }
            Ok(WrittenResults { folder, files, write_error: Some(write_error) }) => {
                let restored_note = previous_results.map_or_else(String::new, PreviousResultsGuard::restore);
                let trouble = format!(
                    "{write_error}; the measurements are in {} instead{restored_note}",
                    folder.display()
                );
                WrittenFiles { folder, files, trouble: Some(trouble) }
            }
            Err(error) => {
                let rows = previous_results.as_ref().and_then(PreviousResultsGuard::keep_rows);
                let restored_note = previous_results.map_or_else(String::new, PreviousResultsGuard::restore);
                let rows = rows.as_deref().unwrap_or(DATA);
                let trouble = format!("{error}; {rows} has the rows that fit{restored_note}");
                WrittenFiles { folder: self.path().to_owned(), files: Vec::new(), trouble: Some(trouble) }
            }
        }
    }
}

fn failure(error: FolderError) -> Failure {
    let exit = match error {
        FolderError::NotEmpty(_) => Exit::Usage,
        FolderError::Busy(_) => Exit::Unavailable,
        _ => Exit::Unwritten,
    };
    Failure::new(exit, error)
}
