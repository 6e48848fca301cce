//! Errors of the spool. Each text says what was tried, on which file, and what to do.

use std::io;
use std::path::PathBuf;

use peernet_logger::HostId;
use sqlx::migrate::MigrateError;

/// Primary result codes of SQLite (sqlite.org/rescode.html).
const IO: i32 = 10;
const CORRUPT: i32 = 11;
const FULL: i32 = 13;
const CANNOT_OPEN: i32 = 14;
const NOT_A_DATABASE: i32 = 26;

/// Reason why a spool cannot be used at the start.
#[derive(Debug, thiserror::Error)]
pub enum SpoolError {
    /// SQLite cannot open or read the file.
    #[error("cannot open the spool {}: {source}; check that its folder exists, that this user may write there, and that the disk is not full", .path.display())]
    Open {
        /// Path of the spool.
        path: PathBuf,
        /// Error of SQLite.
        source: sqlx::Error,
    },
    /// The spool's folder or its lock file cannot be used.
    #[error("cannot {action} {}: {source}; check [spool] file and its permissions", .path.display())]
    Io {
        /// Verb that says what was tried.
        action: &'static str,
        /// File or folder of the failed operation.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// Another agent has locked the spool.
    #[error("another agent uses the spool {}; stop that agent, or configure a separate [spool] file for each agent", .0.display())]
    InUse(PathBuf),
    /// The file is not a spool.
    #[error("the file {} {refusal_reason}", .path.display())]
    NotASpool {
        /// Path of the file.
        path: PathBuf,
        /// Text that says what the file is, and what to do.
        refusal_reason: &'static str,
    },
    /// The spool was written by a newer version.
    #[error("the spool {} was written by a newer version (schema {found}; this version supports {known}); update this program, or choose another file with [spool] file", .path.display())]
    NewerSchema {
        /// Path of the spool.
        path: PathBuf,
        /// Schema in the file.
        found: i64,
        /// Newest schema that this version knows.
        known: i64,
    },
    /// The schema cannot be migrated.
    #[error("cannot migrate the schema of the spool {}: {source}; move the file away to start with an empty spool", .path.display())]
    Migrate {
        /// Path of the spool.
        path: PathBuf,
        /// Error of the failed migration.
        source: MigrateError,
    },
    /// The spool belongs to another host.
    #[error("the spool {} has events of the host {found}, and this host is {own}; restore the file host-id that belongs to the spool, or choose another file with [spool] file", .path.display())]
    OtherHost {
        /// Path of the spool.
        path: PathBuf,
        /// Id of the host whose events are in the spool.
        found: String,
        /// Id of this host.
        own: HostId,
    },
    /// The data in the spool is inconsistent.
    #[error("the spool {} is damaged: {defect}", .path.display())]
    Damaged {
        /// Path of the spool.
        path: PathBuf,
        /// Inconsistency that was found.
        defect: SpoolDefect,
    },
}

/// Defect of a spool that SQLite can read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpoolDefect {
    /// An earlier process found the file damaged and created the damage flag. The text of the flag is the reason.
    #[error("{0}")]
    DamageFlag(String),
    /// The id of the spool's stream cannot be read.
    #[error("its stream id {0:?} is invalid")]
    StreamId(String),
    /// A chain hash has the wrong length.
    #[error("one of its chain hashes has {0} bytes instead of 16")]
    ChainLength(usize),
    /// The numbers of the spool's batches are inconsistent.
    #[error(
        "its batch numbers are inconsistent: first {first}, acknowledged {acknowledged}, newest {newest}"
    )]
    BatchNumbers {
        /// Number of the first batch of the stream.
        first: i64,
        /// Number of the newest batch that the aggregator acknowledged.
        acknowledged: u64,
        /// Number of the newest batch that was written.
        newest: u64,
    },
}

impl SpoolError {
    /// Returns whether the file itself is damaged, so a retry, other permissions or free disk space do not help.
    pub(super) fn is_damage(&self) -> bool {
        match self {
            Self::Damaged { .. } => true,
            Self::Open { source, .. } | Self::Migrate { source: MigrateError::Execute(source), .. } => {
                is_corrupt(source)
            }
            _ => false,
        }
    }

    /// Returns a text that describes the damage. The text omits the advice of `Open` and `Migrate`, which is about
    /// other causes.
    pub(super) fn damage(&self) -> String {
        match self {
            Self::Open { path, source } => format!("the spool {} is damaged: {source}", path.display()),
            Self::Migrate { path, source } => format!("the spool {} is damaged: {source}", path.display()),
            error => error.to_string(),
        }
    }

    /// Returns whether the cause may be a full disk. SQLite reports an I/O error, or that it cannot open the file, if
    /// the index of its write-ahead log does not fit on the disk.
    pub(super) fn may_be_full_disk(&self) -> bool {
        matches!(
            self,
            Self::Open { source, .. } | Self::Migrate { source: MigrateError::Execute(source), .. }
                if matches!(code(source), Some(FULL | IO | CANNOT_OPEN))
        )
    }
}

/// Error of an operation on an open spool.
#[derive(Debug, thiserror::Error)]
pub(in crate::outbox) enum SpoolFileError {
    /// The path refers to another file or to no file. Batches that are written now would be lost when this process
    /// ends.
    #[error("the spool {} was deleted, moved or replaced while it was in use; move it back. A restart of the agent creates a new spool; events of the old spool that the aggregator has not stored yet are then lost", .0.display())]
    Moved(PathBuf),
    /// The disk is full.
    #[error("cannot {action} the spool {}: the disk is full; free some space; the agent retries", .path.display())]
    Full {
        /// Verb that says what was tried.
        action: &'static str,
        /// Path of the spool.
        path: PathBuf,
    },
    /// The file is damaged.
    #[error("cannot {action} the spool {}: {source}; restart the agent, which then quarantines the file, recovers its intact batches and creates a new one", .path.display())]
    Corrupt {
        /// Verb that says what was tried.
        action: &'static str,
        /// Path of the spool.
        path: PathBuf,
        /// Error of SQLite.
        source: sqlx::Error,
    },
    /// Any other error.
    #[error("cannot {action} the spool {}: {source}; check the disk and the file's permissions; the agent retries", .path.display())]
    Failed {
        /// Verb that says what was tried.
        action: &'static str,
        /// Path of the spool.
        path: PathBuf,
        /// Error of SQLite.
        source: sqlx::Error,
    },
}

impl SpoolFileError {
    pub(super) fn new(action: &'static str, path: PathBuf, source: sqlx::Error) -> Self {
        match code(&source) {
            Some(FULL) => Self::Full { action, path },
            _ if is_corrupt(&source) => Self::Corrupt { action, path, source },
            _ => Self::Failed { action, path, source },
        }
    }
}

/// Returns whether SQLite reports that the disk is full.
pub(super) fn is_full(error: &sqlx::Error) -> bool {
    code(error) == Some(FULL)
}

/// Returns whether SQLite reports that the file is damaged.
pub(super) fn is_corrupt(error: &sqlx::Error) -> bool {
    matches!(code(error), Some(CORRUPT | NOT_A_DATABASE))
}

/// Returns SQLite's primary result code; `None` if the error does not come from SQLite.
fn code(error: &sqlx::Error) -> Option<i32> {
    let code: i32 = error.as_database_error()?.code()?.parse().ok()?;
    // The lowest byte of an extended result code is the primary result code.
    Some(code & 0xff)
}
