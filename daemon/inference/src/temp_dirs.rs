//! Temporary folders that are removed at the end of the process, even if models still use them.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Set of the temporary folders of a bank's models; clones share the set.
#[derive(Clone, Debug, Default)]
pub(crate) struct TempDirs(Arc<Mutex<BTreeSet<PathBuf>>>);

impl TempDirs {
    /// Adds a folder that was created.
    pub(crate) fn register(&self, folder: &Path) {
        self.lock().insert(folder.to_owned());
    }

    /// Removes a folder from the set, because its owner deletes it.
    pub(crate) fn deregister(&self, folder: &Path) {
        self.lock().remove(folder);
    }

    /// Deletes all folders in the set, even if they are in use: mapped files stay readable until the process ends.
    pub(crate) fn delete_all(&self) {
        for folder in std::mem::take(&mut *self.lock()) {
            if let Err(error) = fs::remove_dir_all(&folder) {
                tracing::warn!(%error, folder = %folder.display(), "cannot remove a model's temporary folder");
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeSet<PathBuf>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_registered_folders_are_deleted() {
        let parent = tempfile::tempdir().expect("a folder");
        let [deregistered, registered] = ["deregistered", "registered"].map(|name| parent.path().join(name));
        let temp_dirs = TempDirs::default();
        for folder in [&deregistered, &registered] {
            fs::create_dir(folder).expect("made");
            fs::write(folder.join("weights.bin"), b"x").expect("written");
            temp_dirs.register(folder);
        }
        temp_dirs.deregister(&deregistered);
        temp_dirs.delete_all();
        assert!(deregistered.exists() && !registered.exists());
    }
}
