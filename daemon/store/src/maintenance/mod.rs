//! What an operator does with the file: copies of it and looks at its health, beside a running aggregator; roll-ups made
//! anew and a damaged file repaired, without one.

mod backup;
mod doctor;
mod rebuild;
mod repair;
mod secrets;

use std::path::Path;
use std::time::Duration;

use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;

pub use self::backup::{Backup, BackupError, Copied};
pub use self::doctor::{
    DoctorError, Examination, FileFigures, Finding, GapGroup, Integrity, OpenRun, QuarantineGroup, Report,
    RollupExtent, Schema, Severity, StreamState, TableRows, examine,
};
pub use self::rebuild::{RebuildError, Rebuilt, rebuild_rollups};
pub use self::repair::{RepairError, Repaired, SalvagedTable, repair};
pub use self::secrets::{ClearSecretError, ClearedSecret, clear_host_secret};
pub use super::contents::Contents;

/// How long a command waits for another program that locks the file.
const BUSY: Duration = Duration::from_secs(10);

/// Settings of a connection that changes nothing.
fn reading(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new().filename(path).read_only(true).busy_timeout(BUSY).disable_statement_logging()
}

/// Bytes that this user may still write to the disk of a file or folder.
///
/// # Errors
/// When it cannot be told: there is no such file, or the user may not look there.
pub fn free_bytes(path: &Path) -> std::io::Result<u64> {
    let disk = rustix::fs::statvfs(path)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}
