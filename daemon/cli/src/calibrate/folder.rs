//! Folder for the results of a calibration.

use std::path::{Path, PathBuf};

use crate::exit::{Exit, Failure};
use anyhow::anyhow;
use peernet_clock::WallTime;
use peernet_networks::Address;

use super::Arguments;

/// The folder for the results. It is created before anything is measured, so that a folder that cannot be used is an
/// error at the start.
pub(super) struct Folder {
    path: PathBuf,
    /// `true` if the folder was created for this calibration.
    is_created: bool,
}

impl Folder {
    /// Creates the folder of `--result-loc`, or a folder that is named after peer and time.
    ///
    /// # Errors
    /// When the folder is not empty (exit code 64) or cannot be created (exit code 73).
    pub(super) fn make(arguments: &Arguments, peer: &Address, at: WallTime) -> Result<Self, Failure> {
        let path = arguments.result_loc.clone().unwrap_or_else(|| default_path(peer, at));
        let entries = std::fs::read_dir(&path);
        let is_created = entries.is_err();
        if entries.is_ok_and(|mut entries| entries.next().is_some()) && !arguments.overwrite {
            let text = anyhow!(
                "the folder {} is not empty; name another with --result-loc, or add --overwrite",
                path.display()
            );
            return Err(Failure::new(Exit::Usage, text));
        }
        std::fs::create_dir_all(&path).map_err(|error| {
            Failure::new(Exit::Unwritten, anyhow!("cannot create the folder {}: {error}", path.display()))
        })?;
        Ok(Self { path, is_created })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Removes the folder if it was created for this calibration, because there is no study to write.
    pub(super) fn discard(&self) {
        if self.is_created {
            // A folder that is not empty is not removed. It does no harm.
            let _ = std::fs::remove_dir(&self.path);
        }
    }
}

fn default_path(peer: &Address, at: WallTime) -> PathBuf {
    let at = chrono::DateTime::from_timestamp_nanos(at.unix_nanos()).format("%Y-%m-%d-%H%M%S");
    let peer: String = peer
        .host()
        .chars()
        .map(|char| if char.is_ascii_alphanumeric() || ".-_".contains(char) { char } else { '-' })
        .collect();
    PathBuf::from(format!("calibration-{peer}-{at}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_is_named_after_peer_and_time() {
        let at = WallTime::from_unix_nanos(1_795_179_293_000_000_000);
        let name = |peer: &str| default_path(&peer.parse().expect("an address"), at).display().to_string();
        assert_eq!(name("tcp://cloud.lab:5551"), "calibration-cloud.lab-2026-11-20-125453");
        assert_eq!(name("tcp://[fe80::1]:5551"), "calibration-fe80--1-2026-11-20-125453");
    }
}
