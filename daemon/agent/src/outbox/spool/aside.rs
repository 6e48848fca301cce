//! Moves a broken spool file aside, so that it does not keep the robot from measuring: a new spool takes its place.

use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use peernet_clock::WallTime;

/// Result of moving a spool aside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::outbox) struct QuarantinedSpool {
    /// Damage of the file.
    pub(in crate::outbox) reason: String,
    /// New path of the file.
    pub(in crate::outbox) kept: PathBuf,
}

/// Renames the spool and its SQLite companions, from which the `sqlite3` shell may recover data. The spool must not
/// be open.
pub(super) fn quarantine(spool: &Path, reason: String, now: WallTime) -> io::Result<QuarantinedSpool> {
    let free = |seconds: i64| {
        let kept = beside(spool, &format!(".damaged-{seconds}"));
        (!kept.exists()).then_some(kept)
    };
    let first = now.unix_seconds();
    let kept = (first..=i64::MAX).find_map(free).unwrap_or_else(|| beside(spool, ".damaged"));
    for part in ["-wal", "-shm", ""] {
        match fs::rename(beside(spool, part), beside(&kept, part)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound || part.is_empty() => return Err(error),
            _ => {}
        }
    }
    match fs::remove_file(mark(spool)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(QuarantinedSpool { reason, kept }),
    }
}

/// Marks a spool that turned out to be broken while it was open. The next start moves it aside.
pub(super) fn condemn(spool: &Path, reason: &str) {
    if let Err(error) = fs::write(mark(spool), format!("{reason}\n")) {
        tracing::warn!(%error, "cannot note that the spool {} is broken", spool.display());
    }
}

/// Returns why the spool is marked as broken, if it is. A mark without a spool is a leftover and is removed: the file
/// was taken away, or moving it was interrupted.
pub(super) fn condemned(spool: &Path) -> Option<String> {
    let reason = fs::read_to_string(mark(spool)).ok()?;
    if !spool.exists() {
        if let Err(error) = fs::remove_file(mark(spool)) {
            tracing::warn!(%error, "cannot remove the mark of a broken spool that is gone: {}", mark(spool).display());
        }
        return None;
    }
    Some(reason.trim().to_owned())
}

fn mark(spool: &Path) -> PathBuf {
    beside(spool, "-condemned")
}

/// Returns the path with `ending` added to its last part.
pub(super) fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(ending);
    name.into()
}
