//! Commands of an operator on the database's file. Backup and examination work while an aggregator runs. For a rebuild
//! of the roll-ups and for a repair the aggregator must be stopped.

mod backup;
mod doctor;
mod rebuild;
mod repair;
mod secrets;

use std::path::Path;
use std::time::Duration;

use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;

pub use self::backup::{Backup, BackupError, FinishedCopy};
pub use self::doctor::{
    DoctorError, Examination, FileSizes, Finding, GapGroup, Integrity, OpenRun, QuarantineGroup, Report,
    RollupExtent, Schema, Severity, StreamState, TableRows, examine,
};
pub use self::rebuild::{RebuildError, Rebuilt, rebuild_rollups};
pub use self::repair::{RepairError, RepairResult, SalvagedTable, repair};
pub use self::secrets::{ClearSecretError, ClearedSecret, clear_host_secret};
pub use super::file_kind::FileKind;

/// Longest wait of a command for another program that locks the file.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

/// Returns the settings of a connection that changes nothing.
fn read_only_options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .read_only(true)
        .busy_timeout(BUSY_TIMEOUT)
        .disable_statement_logging()
}

/// Returns the number of bytes that this process may still write to the disk of a file or folder.
///
/// # Errors
/// When the file does not exist or this process has no permission to examine it.
pub fn free_bytes(path: &Path) -> std::io::Result<u64> {
    let disk = rustix::fs::statvfs(path)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}
