//! Temporary folders that are removed even if their owner was killed: the creation of the next folder removes them.

use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Prefix of the names of all folders that this module creates.
const PREFIX: &str = "peernet-";
/// Name of a file in each folder, which the owner keeps locked while it lives. Folders without this file are never
/// removed.
const LOCK_FILE: &str = ".held";

/// Temporary folder with a file that its owner keeps locked. Dropping it deletes the folder; if the owner was killed,
/// the next creation of such a folder deletes it.
#[derive(Debug)]
pub struct LockedTempDir {
    folder: tempfile::TempDir,
    /// The lock is released when the process ends, for whatever reason.
    _lock: File,
}

impl LockedTempDir {
    /// Creates a folder `peernet-KIND-…` among the system's temporary files, and removes folders of this user's
    /// processes that have ended.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn new(kind: &str) -> io::Result<Self> {
        Self::new_in(&std::env::temp_dir(), kind)
    }

    fn new_in(parent: &Path, kind: &str) -> io::Result<Self> {
        remove_abandoned(parent);
        loop {
            let folder = tempfile::Builder::new().prefix(&format!("{PREFIX}{kind}-")).tempdir_in(parent)?;
            let file = folder.path().join(LOCK_FILE);
            let lock = File::create_new(&file)?;
            match lock.try_lock() {
                // Another program may have found and removed the folder before it was locked.
                Err(TryLockError::WouldBlock) => {}
                Ok(()) if !file.exists() => {}
                // On a file system without locks no program treats the folder as abandoned.
                Ok(()) | Err(TryLockError::Error(_)) => return Ok(Self { folder, _lock: lock }),
            }
        }
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Removes the folders of this user's processes that were killed.
fn remove_abandoned(parent: &Path) {
    let user = rustix::process::geteuid().as_raw();
    for entry in fs::read_dir(parent).into_iter().flatten().filter_map(Result::ok) {
        let is_ours = entry.file_name().as_encoded_bytes().starts_with(PREFIX.as_bytes())
            && entry.metadata().is_ok_and(|metadata| metadata.is_dir() && metadata.uid() == user);
        let (folder, file) = (entry.path(), entry.path().join(LOCK_FILE));
        if !is_ours || !file.is_file() {
            continue;
        }
        // The lock is held until the folder is deleted, so that no second program deletes the folder at the same time.
        let Ok(lock) = File::open(&file) else { continue };
        if lock.try_lock().is_ok()
            && let Err(error) = fs::remove_dir_all(&folder)
        {
            tracing::warn!(%error, folder = %folder.display(), "cannot remove the temporary folder of an ended process");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_folder_removes_only_folders_of_ended_processes() {
        let parent = tempfile::tempdir().expect("a folder");
        let new = || LockedTempDir::new_in(parent.path(), "model").expect("made");
        let in_use = new();
        let LockedTempDir { folder, _lock: lock } = new();
        let kept_folder = folder.keep();
        fs::write(kept_folder.join("weights.bin"), b"x").expect("written");
        let without_lock_file = parent.path().join("peernet-results-x");
        fs::create_dir(&without_lock_file).expect("made");
        let without_prefix = parent.path().join("other");
        fs::create_dir(&without_prefix).expect("made");
        fs::write(without_prefix.join(LOCK_FILE), "").expect("written");

        let later = new();
        assert!(kept_folder.exists(), "its lock is still held, as by a running process");
        drop(lock);
        drop(new());
        assert!(!kept_folder.exists());
        let expected = [in_use.path(), later.path(), &without_lock_file, &without_prefix];
        assert!(expected.into_iter().all(Path::exists));
        let paths = [in_use.path().to_owned(), later.path().to_owned()];
        drop((in_use, later));
        assert!(paths.iter().all(|path| !path.exists()));
    }
}
