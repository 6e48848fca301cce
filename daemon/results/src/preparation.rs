//! Search for result folders, and their preparation.

use std::fs::{File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use peernet_analysis::WriteError;
use peernet_analysis::compare::compare_label;
use peernet_analysis::figure_files::figure_files;
use serde::{Deserialize, Serialize};

use super::FolderError;
use super::file_names::{DATA, RECORD, SENSOR_STUDY, SUMMARIES};

/// Treatment of a folder that is not empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overwrite {
    /// Returns an error.
    #[default]
    Refuse,
    /// Replaces the results in the folder. Other files stay.
    Replace,
    /// Uses a new subfolder: `run-2`, `run-3`, …
    Subfolder,
}

/// Largest depth below a folder at which results are searched.
const MAX_DEPTH: usize = 8;

/// Path of a folder, and the open folder, which holds the lock against other programs.
pub(crate) type LockedFolder = (PathBuf, File);

/// Locks the folder that `overwrite` permits for this program: `dir` or a new subfolder. The files in the folder are
/// not changed.
pub(crate) fn acquire(dir: &Path, overwrite: Overwrite) -> Result<LockedFolder, FolderError> {
    let open_error = |path: &Path| {
        let path = path.to_owned();
        move |error: std::io::Error| FolderError::Open { path, reason: error.to_string() }
    };
    if dir.exists() && !dir.is_dir() {
        return Err(FolderError::NotAFolder(dir.to_owned()));
    }
    std::fs::create_dir_all(dir).map_err(open_error(dir))?;
    // The folder is locked before its entries are read, so that no other program adds files in between.
    let lock_result = lock(dir);
    if overwrite == Overwrite::Replace {
        return Ok((dir.to_owned(), lock_result?));
    }
    let mut entries = std::fs::read_dir(dir).map_err(open_error(dir))?;
    let is_empty = entries.next().is_none();
    match (is_empty, lock_result, overwrite) {
        (true, Ok(lock), _) => Ok((dir.to_owned(), lock)),
        // The folder contains files, or another program has locked it.
        (_, _, Overwrite::Subfolder) => {
            let path = subfolder(dir).map_err(open_error(dir))?;
            let lock = lock(&path)?;
            Ok((path, lock))
        }
        (false, Ok(_), _) => Err(FolderError::NotEmpty(dir.to_owned())),
        (_, Err(error), _) => Err(error),
    }
}

/// Locks the folder itself. Such a lock needs no file in the folder, and the kernel releases the lock however the program
/// ends.
fn lock(dir: &Path) -> Result<File, FolderError> {
    let open_error =
        |error: std::io::Error| FolderError::Open { path: dir.to_owned(), reason: error.to_string() };
    let folder = File::open(dir).map_err(open_error)?;
    match folder.try_lock() {
        Err(TryLockError::WouldBlock) => Err(FolderError::Busy(dir.to_owned())),
        // Not every network file system can lock a folder. Without a lock, results can still be written, which is more
        // important than the protection.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(folder),
    }
}

/// Returns the names of the files that an earlier run may have left in a folder: its results, the study of its sensor,
/// and figures of any kind. The study and the figures would show results that no longer exist.
pub(crate) fn replaced_files(dir: &Path) -> impl Iterator<Item = String> {
    let results = [DATA, RECORD, SENSOR_STUDY].into_iter().chain(SUMMARIES).map(str::to_owned);
    results.chain(figure_files(dir))
}

/// Removes the files of an earlier run.
pub(crate) fn clear(dir: &Path) -> Result<(), FolderError> {
    for path in replaced_files(dir).map(|name| dir.join(name)) {
        remove_if_exists(&path).map_err(WriteError::at(&path))?;
    }
    Ok(())
}

/// Removes a file that may be missing.
///
/// # Errors
/// When the file exists and cannot be removed.
pub fn remove_if_exists(path: &Path) -> std::io::Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Creates the first subfolder that does not exist. Creation is atomic, so that two programs never get the same
/// subfolder.
fn subfolder(dir: &Path) -> std::io::Result<PathBuf> {
    let mut number = 2_u32;
    loop {
        let path = dir.join(format!("run-{number}"));
        match std::fs::create_dir(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
            Err(error) => return Err(error),
        }
    }
}

/// Returns the result folders in a folder and below it.
pub(crate) fn find(dir: &Path) -> Vec<PathBuf> {
    let mut result_folders = Vec::new();
    search(dir, MAX_DEPTH, &mut result_folders);
    result_folders
}

fn search(dir: &Path, remaining_depth: usize, result_folders: &mut Vec<PathBuf>) {
    if dir.join(DATA).is_file() {
        result_folders.push(dir.to_owned());
    }
    let Some(remaining_depth) = remaining_depth.checked_sub(1) else { return };
    // A folder that cannot be listed is skipped, because results in it could not be read either.
    let entries = std::fs::read_dir(dir).into_iter().flatten().filter_map(Result::ok);
    let mut folders: Vec<PathBuf> = entries
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
        // Hidden folders contain results that a run has set aside, or data of other programs.
        .filter(|entry| !entry.file_name().as_encoded_bytes().starts_with(b"."))
        .map(|entry| entry.path())
        .collect();
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    folders.sort_by(|a, b| compare_label(&name(a), &name(b)));
    folders.iter().for_each(|folder| search(folder, remaining_depth, result_folders));
}
