//! Temporary folders that go even when their owner was killed: whoever makes the next one removes them.

use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use tempfile::TempDir;

/// How the names of all begin.
const PREFIX: &str = "peernet-";
/// A file in each, locked by the owner as long as that lives. Folders without it are not ours to remove.
const HELD: &str = ".held";

/// A temporary folder; gone when this is dropped, or else when the next one is made after its owner's end.
#[derive(Debug)]
pub struct Scratch {
    folder: TempDir,
    /// The lock goes with the process, however that ends.
    _held: File,
}

impl Scratch {
    /// Makes one among the system's temporary files, `peernet-KIND-…`, and removes those of this user's processes that
    /// are no more.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn new(kind: &str) -> io::Result<Self> {
        Self::new_in(&std::env::temp_dir(), kind)
    }

    fn new_in(parent: &Path, kind: &str) -> io::Result<Self> {
        sweep(parent);
        loop {
            let folder = tempfile::Builder::new().prefix(&format!("{PREFIX}{kind}-")).tempdir_in(parent)?;
            let file = folder.path().join(HELD);
            let held = File::create_new(&file)?;
            match held.try_lock() {
                // Another program may have found it before it was locked.
                Err(TryLockError::WouldBlock) => {}
                Ok(()) if !file.exists() => {}
                // Where nothing can be locked, nobody takes it for abandoned.
                Ok(()) | Err(TryLockError::Error(_)) => return Ok(Self { folder, _held: held }),
            }
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Removes what processes of this user left that were killed.
fn sweep(parent: &Path) {
    let user = rustix::process::geteuid().as_raw();
    for entry in fs::read_dir(parent).into_iter().flatten().filter_map(Result::ok) {
        let is_ours = entry.file_name().as_encoded_bytes().starts_with(PREFIX.as_bytes())
            && entry.metadata().is_ok_and(|about| about.is_dir() && about.uid() == user);
        let (folder, file) = (entry.path(), entry.path().join(HELD));
        if !is_ours || !file.is_file() {
            continue;
        }
        // Held until the folder is gone, so that nobody takes it meanwhile.
        let Ok(held) = File::open(&file) else { continue };
        if held.try_lock().is_ok()
            && let Err(error) = fs::remove_dir_all(&folder)
        {
            tracing::warn!(%error, folder = %folder.display(), "cannot remove the temporary folder of a process that is no more");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn those_of_the_dead_are_removed_and_those_of_the_living_stay() {
        let parent = tempfile::tempdir().expect("a folder");
        let new = || Scratch::new_in(parent.path(), "model").expect("made");
        let living = new();
        let Scratch { folder, _held: held } = new();
        let dead = folder.keep();
        fs::write(dead.join("weights.bin"), b"x").expect("written");
        let rescued = parent.path().join("peernet-results-x");
        fs::create_dir(&rescued).expect("made");
        let other = parent.path().join("other");
        fs::create_dir(&other).expect("made");
        fs::write(other.join(HELD), "").expect("written");

        let later = new();
        assert!(dead.exists(), "its lock is held still");
        drop(held);
        drop(new());
        assert!(!dead.exists());
        assert!([living.path(), later.path(), &rescued, &other].into_iter().all(Path::exists));
        let paths = [living.path().to_owned(), later.path().to_owned()];
        drop((living, later));
        assert!(paths.iter().all(|path| !path.exists()));
    }
}
