//! The folder of an experiment: `experiment.json` with the state, and the folders of the runs.
//!
//! `experiment.json` holds the plan with the state of each run and is replaced as a whole before and after every run,
//! so that a killed experiment can be continued if its plan is unchanged.

use std::ffi::OsStr;
use std::fs::{self, File, TryLockError};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use anyhow::anyhow;
use peernet_analysis::figure_files::figure_files;
use peernet_external::exec::with_arguments;
use peernet_results::remove_if_exists;

use super::plan::{Plan, Run};
use super::plan_differences::differences;
use super::state::Record;
use crate::experiment::{RECORD, RUNS, read_record, result_dirs, status_by_results};

/// Names of the tables over all runs.
const TABLES: [&str; 3] = ["compare", "users", "sensors"];
/// Extensions of the formats in which each table is written.
const FORMATS: [&str; 4] = ["txt", "md", "csv", "tex"];
/// Name of the file that is locked while a program uses the folder.
const LOCK: &str = ".lock";
/// Prefix of a record's file name until it is complete. A killed program leaves such a file behind.
const DRAFT_PREFIX: &str = ".experiment-";

/// A locked folder, to which no other program writes.
pub(super) struct Folder {
    path: PathBuf,
    /// Open file that holds the lock. The operating system releases the lock however the program ends.
    _lock: File,
}

impl Folder {
    /// Creates the folder or opens an existing one, and locks it.
    ///
    /// # Errors
    /// When another program uses it (exit code 69), it holds other files (exit code 64) or cannot be created (exit code
    /// 73).
    pub(super) fn open(path: &Path) -> Result<Self, Failure> {
        let cannot_create = |error: std::io::Error| {
            let error = dangling_link(path).unwrap_or_else(|| error.to_string());
            Failure::new(Exit::Unwritten, anyhow!("cannot create the folder {}: {error}", path.display()))
        };
        let entries = fs::read_dir(path).into_iter().flatten().filter_map(Result::ok);
        let is_own = |name: &OsStr| name == LOCK || name == RUNS || is_draft(name);
        let has_foreign_files = entries.map(|entry| entry.file_name()).any(|name| !is_own(&name));
        // Checked before anything is created or removed: a wrong path must not change the user's folder.
        if has_foreign_files && !path.join(RECORD).exists() {
            let text = format!(
                "{} contains files, but no {RECORD}: it is not the folder of an experiment; name another with --result-loc",
                path.display()
            );
            return Err(Failure::new(Exit::Usage, anyhow!("{text}")));
        }
        fs::create_dir_all(path.join(RUNS)).map_err(cannot_create)?;
        let lock = File::create(path.join(LOCK)).map_err(cannot_create)?;
        match lock.try_lock() {
            Ok(()) => {
                // Drafts are removed only with the lock: without the lock, another program may be writing its draft.
                drafts(path).for_each(|draft| drop(fs::remove_file(draft)));
                Ok(Self { path: path.to_owned(), _lock: lock })
            }
            Err(TryLockError::WouldBlock) => {
                let text = format!("another peernet run uses {}; wait for it or stop it", path.display());
                Err(Failure::new(Exit::Unavailable, anyhow!("{text}")))
            }
            Err(TryLockError::Error(error)) => Err(cannot_create(error)),
        }
    }

    /// Returns the path of the folder.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the folder of a run's results. If the run has several users (edges at the same time), returns the folder
    /// of each user's results.
    pub(super) fn results(&self, plan: &Plan, run: &Run) -> Vec<PathBuf> {
        result_dirs(&self.run_dir(run), plan.configuration(run).users).collect()
    }

    /// Replaces the record as a whole.
    ///
    /// # Errors
    /// When it cannot be written (exit code 73).
    pub(super) fn save(&self, record: &Record) -> Result<(), Failure> {
        let path = self.path.join(RECORD);
        let write = || {
            // Written next to the record, synced and then renamed: the record is complete even after a crash or power
            // failure.
            let mut file = tempfile::Builder::new().prefix(DRAFT_PREFIX).tempfile_in(&self.path)?;
            // Without `with_arguments`, programs in the plan would lose their arguments, and the plan of a continued
            // experiment would differ.
            with_arguments(|| serde_json::to_writer_pretty(&mut file, record))?;
            writeln!(file)?;
            file.as_file().sync_all()?;
            file.persist(&path).map_err(|error| error.error)?;
            Ok(())
        };
        write().map_err(|error: std::io::Error| {
            Failure::new(Exit::Unwritten, anyhow!("cannot write {}: {error}", path.display()))
        })
    }

    /// Removes the tables and figures over all runs.
    ///
    /// # Errors
    /// When something cannot be removed (exit code 73).
    pub(super) fn remove_tables_and_figures(&self) -> Result<(), Failure> {
        let tables = TABLES.iter().flat_map(|table| FORMATS.map(|format| format!("{table}.{format}")));
        for path in tables.chain(figure_files(&self.path)).map(|name| self.path.join(name)) {
            remove_if_exists(&path).map_err(|error| cannot_remove(&path, &error))?;
        }
        Ok(())
    }

    /// Removes all runs and the record.
    ///
    /// # Errors
    /// When something cannot be removed (exit code 73).
    pub(super) fn clear(&self, record: &Record) -> Result<(), Failure> {
        record.plan.runs.iter().try_for_each(|run| self.remove(run))?;
        let path = self.path.join(RECORD);
        fs::remove_file(&path).map_err(|error| cannot_remove(&path, &error))
    }

    /// Removes the results of a run that is measured again.
    ///
    /// # Errors
    /// When something cannot be removed (exit code 73).
    pub(super) fn remove(&self, run: &Run) -> Result<(), Failure> {
        let folder = self.run_dir(run);
        match fs::remove_dir_all(&folder) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(cannot_remove(&folder, &error)),
            _ => Ok(()),
        }
    }

    /// Removes the folder if it is empty.
    pub(super) fn discard(self) {
        // Files and folders that remain do no harm.
        let _ = fs::remove_file(self.path.join(LOCK));
        let _ = fs::remove_dir(self.path.join(RUNS));
        let _ = fs::remove_dir(&self.path);
    }

    fn run_dir(&self, run: &Run) -> PathBuf {
        self.path.join(RUNS).join(&run.folder)
    }
}

fn is_draft(name: &OsStr) -> bool {
    name.to_string_lossy().starts_with(DRAFT_PREFIX)
}

/// Returns incomplete records that killed programs left behind.
fn drafts(path: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = fs::read_dir(path).into_iter().flatten().filter_map(Result::ok);
    entries.filter(|entry| is_draft(&entry.file_name())).map(|entry| entry.path())
}

/// Reads the record in a folder; `None` if there is no record. [`status_by_results`] determines the status of each run from
/// the recorded status and the results.
///
/// # Errors
/// When it cannot be read (exit code 65).
pub(super) fn load(path: &Path) -> Result<Option<Record>, Failure> {
    let record = read_record(path, |record: &Record| record.format, Record::is_sound);
    let mut record = record.map_err(|error| {
        let record_path = path.join(RECORD);
        let text = format!("cannot read {}: {error}; --restart starts again", record_path.display());
        Failure::new(Exit::Data, anyhow!("{text}"))
    })?;
    if let Some(Record { plan, states, .. }) = &mut record {
        for (run, state) in plan.runs.iter().zip(states) {
            let users = plan.configuration(run).users;
            state.status = status_by_results(state.status, &path.join(RUNS).join(&run.folder), users);
        }
    }
    Ok(record)
}

/// Checks that the plan is unchanged since the experiment was started.
///
/// # Errors
/// When it has changed; the text lists the differences (exit code 78).
pub(super) fn ensure_unchanged(record: &Record, plan: &Plan) -> Result<(), Failure> {
    if record.plan == *plan {
        return Ok(());
    }
    // Without `with_arguments`, a changed argument of a program would be no difference.
    let json = |plan: &Plan| with_arguments(|| serde_json::to_value(plan)).unwrap_or_default();
    let text = format!(
        "the experiment has changed since it was started:\n  {}\ncontinue with the old file and options, start again with --restart, which removes the runs, or choose another folder with --result-loc",
        differences(&json(&record.plan), &json(plan)).join("\n  ")
    );
    Err(Failure::new(Exit::Configuration, anyhow!("{text}")))
}

/// Describes a broken symbolic link on the path, because no folder can be created with its name.
fn dangling_link(path: &Path) -> Option<String> {
    let link = path.ancestors().find(|part| part.is_symlink() && !part.exists())?;
    let target = link.read_link().ok()?;
    Some(format!("{} is a link to {}, which does not exist", link.display(), target.display()))
}

fn cannot_remove(path: &Path, error: &std::io::Error) -> Failure {
    Failure::new(Exit::Unwritten, anyhow!("cannot remove {}: {error}", path.display()))
}
