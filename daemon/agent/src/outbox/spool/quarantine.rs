//! Quarantines a damaged spool: renames the file, so that a new spool can be created and the robot can measure.
//!
//! A damaged spool that is open is only flagged: the *damage flag* is a file beside the spool with the reason as its
//! text. The next start quarantines a flagged spool.

use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use peernet_clock::WallTime;

use super::RecoveryCounts;

/// A quarantined spool.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::outbox) struct QuarantinedSpool {
    /// Damage of the file.
    pub(in crate::outbox) reason: String,
    /// New path of the file.
    pub(in crate::outbox) new_path: PathBuf,
    /// Length of the file and its write-ahead log, in bytes.
    pub(in crate::outbox) bytes: u64,
    /// Numbers of recovered and of lost batches; the reason as text if no batch was recovered.
    pub(in crate::outbox) recovered: Result<RecoveryCounts, String>,
}

/// Renames the spool, its write-ahead log (`-wal`) and its shared memory (`-shm`). The `sqlite3` shell may recover data
/// from these files. The spool must not be open. Recovers no batch.
pub(super) fn quarantine(spool: &Path, reason: String, now: WallTime) -> io::Result<QuarantinedSpool> {
    // A spool that was quarantined in the same second must not be overwritten.
    let unused_path = |seconds: i64| {
        let path = with_suffix(spool, &format!(".damaged-{seconds}"));
        (!path.exists()).then_some(path)
    };
    let first_seconds = now.unix_seconds();
    let new_path =
        (first_seconds..=i64::MAX).find_map(unused_path).unwrap_or_else(|| with_suffix(spool, ".damaged"));
    let length = |suffix| fs::metadata(with_suffix(spool, suffix)).map_or(0, |metadata| metadata.len());
    let bytes = length("") + length("-wal");
    // The spool itself is renamed last. If renaming is interrupted earlier, no new spool is created beside an old log,
    // which SQLite would apply to the new spool.
    for suffix in ["-wal", "-shm", ""] {
        match fs::rename(with_suffix(spool, suffix), with_suffix(&new_path, suffix)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound || suffix.is_empty() => return Err(error),
            _ => {}
        }
    }
    match fs::remove_file(damage_flag_path(spool)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => {
            let recovered = Err("recovery was not tried".to_owned());
            Ok(QuarantinedSpool { reason, new_path, bytes, recovered })
        }
    }
}

/// Creates the damage flag of an open spool.
pub(super) fn flag_as_damaged(spool: &Path, reason: &str) {
    if let Err(error) = fs::write(damage_flag_path(spool), format!("{reason}\n")) {
        tracing::warn!(%error, "cannot flag the spool {} as damaged; the next start will not quarantine it", spool.display());
    }
}

/// Returns the reason why the spool is flagged as damaged; `None` if it is not flagged. A damage flag without a spool
/// is removed: the spool was deleted, or its quarantine was interrupted.
pub(super) fn quarantine_reason(spool: &Path) -> Option<String> {
    let reason = fs::read_to_string(damage_flag_path(spool)).ok()?;
    if !spool.exists() {
        if let Err(error) = fs::remove_file(damage_flag_path(spool)) {
            tracing::warn!(%error, "cannot remove {}, the damage flag of a spool that no longer exists", damage_flag_path(spool).display());
        }
        return None;
    }
    Some(reason.trim().to_owned())
}

fn damage_flag_path(spool: &Path) -> PathBuf {
    // The suffix must not change, because an earlier version may have created the flag.
    with_suffix(spool, "-condemned")
}

/// Returns the path with a suffix appended to its last component.
pub(super) fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}
