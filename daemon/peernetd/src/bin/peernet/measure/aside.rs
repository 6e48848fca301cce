//! Earlier results, while it is not sure yet that there will be others.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::Context;
use peernet_report::results::ResultFolder;
use peernetd::exit::{Exit, Failure};
use peernetd::output::complain;
use tempfile::TempDir;

/// Results that were moved out of the way. Dropping it puts them back.
#[derive(Debug)]
pub(super) struct Aside {
    home: PathBuf,
    /// A folder in it; `None` when there is nothing to put back.
    kept: Option<TempDir>,
}

impl Aside {
    /// Moves the results in a folder aside.
    ///
    /// # Errors
    /// When they cannot be moved (73).
    pub(super) fn put(home: &Path) -> Result<Self, Failure> {
        let mut aside = Self { home: home.to_owned(), kept: None };
        if !ResultFolder::replaced().any(|name| home.join(name).is_file()) {
            return Ok(aside);
        }
        let unwritten = |error: anyhow::Error| Failure::new(Exit::Unwritten, error);
        let kept = tempfile::Builder::new().prefix(".replaced-").tempdir_in(home);
        let kept = kept.with_context(|| format!("cannot write to {}", home.display())).map_err(unwritten)?;
        let kept = aside.kept.insert(kept).path().to_owned();
        for name in ResultFolder::replaced() {
            let from = home.join(&name);
            match std::fs::rename(&from, kept.join(&name)) {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    let error = anyhow::Error::new(error);
                    return Err(unwritten(error.context(format!("cannot replace {}", from.display()))));
                }
                _ => {}
            }
        }
        Ok(aside)
    }

    /// There are others in their place: they are removed.
    pub(super) fn remove(&mut self) {
        if let Some(kept) = self.kept.take()
            && let Err(error) = kept.close()
        {
            complain(format_args!("the results that were replaced are not all removed: {error}"));
        }
    }
}

impl Drop for Aside {
    fn drop(&mut self) {
        let Some(kept) = self.kept.take() else { return };
        if std::thread::panicking() {
            // Rows may stand in their place by now.
            let folder = kept.keep();
            return complain(format_args!("the earlier results are in {}", folder.display()));
        }
        let back = |name: String| match std::fs::rename(kept.path().join(&name), self.home.join(&name)) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        };
        if let Err(error) = ResultFolder::replaced().try_for_each(back) {
            let folder = kept.keep();
            complain(format_args!("the earlier results are in {}: {error}", folder.display()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_back_unless_there_are_others() {
        let home = tempfile::tempdir().expect("a folder");
        let (data, mine) = (home.path().join("data.csv"), home.path().join("mine.txt"));
        std::fs::write(&data, "earlier").expect("writable");
        std::fs::write(&mine, "mine").expect("writable");
        let aside = Aside::put(home.path()).expect("moved");
        assert!(!data.exists() && mine.exists());
        drop(aside);
        assert_eq!(std::fs::read_to_string(&data).expect("is back"), "earlier");

        let mut aside = Aside::put(home.path()).expect("moved");
        std::fs::write(&data, "later").expect("writable");
        aside.remove();
        drop(aside);
        assert_eq!(std::fs::read_to_string(&data).expect("is there"), "later");
        assert_eq!(std::fs::read_dir(home.path()).expect("a folder").count(), 2, "nothing is left over");
    }
}
