//! Temporary folders to be removed at the end of the process, even if models still use them.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Set of the temporary folders of a bank's models; clones share the set.
#[derive(Clone, Debug, Default)]
pub(crate) struct Litter(Arc<Mutex<BTreeSet<PathBuf>>>);

impl Litter {
    /// Adds a folder that was created.
    pub(crate) fn made(&self, folder: &Path) {
        self.lock().insert(folder.to_owned());
    }

    /// Removes a folder from the set, because its owner deletes it.
    pub(crate) fn removed(&self, folder: &Path) {
        self.lock().remove(folder);
    }

    /// Deletes all folders in the set, even if they are in use: mapped files stay readable until the process ends.
    pub(crate) fn sweep(&self) {
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
    fn what_nobody_removed_is_swept() {
        let parent = tempfile::tempdir().expect("a folder");
        let [kept, left] = ["kept", "left"].map(|name| parent.path().join(name));
        let litter = Litter::default();
        for folder in [&kept, &left] {
            fs::create_dir(folder).expect("made");
            fs::write(folder.join("weights.bin"), b"x").expect("written");
            litter.made(folder);
        }
        litter.removed(&kept);
        litter.sweep();
        assert!(kept.exists() && !left.exists());
    }
}
