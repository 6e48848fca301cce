//! The folder of results of a run.

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;
use peernet_results::{FolderError, Overwrite, ResultFolder, RowWriter, WrittenResults};

use super::Order;
use super::aside::Aside;

/// A folder that is there and can be written to before anything is measured.
pub(super) struct Results {
    /// The results that are to be replaced. They come back before others may use the folder.
    earlier: Option<Aside>,
    folder: ResultFolder,
    /// Whether it was made for this run.
    made: bool,
}

/// Where the results are.
pub(super) struct Written {
    pub(super) folder: PathBuf,
    pub(super) files: Vec<PathBuf>,
    /// Why they are not where they were to be, and where they are.
    pub(super) trouble: Option<String>,
}

impl Results {
    /// Makes the folder that the order names.
    ///
    /// # Errors
    /// When it holds results that may not be replaced (64), another program writes there (69), or it cannot be made (73).
    pub(super) fn begin(order: &Order) -> Result<Self, Failure> {
        // The lock says that no run is under way there; nothing is touched by it.
        if Aside::is_left(&order.folder)
            && let Ok(folder) = ResultFolder::acquire(&order.folder, Overwrite::Replace)
        {
            Aside::recover(folder.path())?;
        }
        let was_there = order.folder.exists();
        let folder = ResultFolder::acquire(&order.folder, order.overwrite).map_err(failure)?;
        let replaces = was_there && order.overwrite == Overwrite::Replace;
        let earlier = replaces.then(|| Aside::put(folder.path())).transpose()?;
        let made = !was_there || folder.path() != order.folder;
        Ok(Self { folder, made, earlier })
    }

    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        self.folder.path()
    }

    /// What takes the rows.
    ///
    /// # Errors
    /// When the file cannot be written (73).
    pub(super) fn writer(&self) -> Result<RowWriter, Failure> {
        self.folder.writer().map_err(failure)
    }

    /// Takes away what was made: there is nothing to keep. What was to be replaced comes back.
    pub(super) fn discard(self) {
        // A file that stays does no harm.
        let _ = std::fs::remove_file(self.path().join("data.csv"));
        if self.made {
            let _ = std::fs::remove_dir(self.path());
        }
        drop(self.earlier);
    }

    /// Writes everything, elsewhere if it must be.
    pub(super) fn finish(&mut self, record: &RunRecord, rows: &Rows) -> Written {
        let mut earlier = self.earlier.take();
        match self.folder.finish(record, rows) {
            Ok(WrittenResults { folder, files, trouble: None }) => {
                if let Some(earlier) = &mut earlier {
                    earlier.remove();
                }
                Written { folder, files, trouble: None }
            }
            Ok(WrittenResults { folder, files, trouble: Some(trouble) }) => {
                let back = earlier.map_or_else(String::new, Aside::give_back);
                let trouble =
                    format!("{trouble}; all that was measured is in {} instead{back}", folder.display());
                Written { folder, files, trouble: Some(trouble) }
            }
            Err(error) => {
                let rows = earlier.as_ref().and_then(Aside::keep_rows);
                let back = earlier.map_or_else(String::new, Aside::give_back);
                let rows = rows.as_deref().unwrap_or("data.csv");
                let trouble = format!("{error}; {rows} holds what there was room for{back}");
                Written { folder: self.path().to_owned(), files: Vec::new(), trouble: Some(trouble) }
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
