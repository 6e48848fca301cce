//! What can go wrong with the spool, in words that say what was tried, on which file, and what to do.

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

/// Why a spool cannot be used at the start.
#[derive(Debug, thiserror::Error)]
pub enum SpoolError {
    /// SQLite cannot open or read the file.
    #[error("cannot open the spool {}: {source}; check that its folder exists, that this user may write there, and that the disk has room", .path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// SQLite's own words.
        source: sqlx::Error,
    },
    /// Its folder, or the file beside it that is locked, cannot be used.
    #[error("cannot {action} {}: {source}; check [spool] file and its permissions", .path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// The system's own words.
        source: io::Error,
    },
    /// Another agent has it.
    #[error("another agent uses the spool {}; stop it, or give each agent a [spool] file of its own", .0.display())]
    InUse(PathBuf),
    /// Something else is there under its name.
    #[error("the file {} {objection}", .path.display())]
    NotASpool {
        /// The file.
        path: PathBuf,
        /// What it is, and what to do.
        objection: &'static str,
    },
    /// It was written by a newer version.
    #[error("the spool {} was written by a newer version (its schema {found}, known here {known}); update this program, or choose another file with [spool] file", .path.display())]
    NewerSchema {
        /// The file.
        path: PathBuf,
        /// Schema in the file.
        found: i64,
        /// Newest schema that this version knows.
        known: i64,
    },
    /// Its schema cannot be brought up to date.
    #[error("cannot bring the schema of the spool {} up to date: {source}; move the file away to begin with an empty one", .path.display())]
    Migrate {
        /// The file.
        path: PathBuf,
        /// The failed step in sqlx's words.
        source: MigrateError,
    },
    /// It holds the events of another host.
    #[error("the spool {} holds events of the host {found}, and this host is {own}; put back the file host-id that belongs to it, or choose another file with [spool] file", .path.display())]
    OtherHost {
        /// The file.
        path: PathBuf,
        /// Whose it is.
        found: String,
        /// Whose it should be.
        own: HostId,
    },
    /// What it says of itself makes no sense.
    #[error("the spool {} is damaged: {what}", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: SpoolDefect,
    },
}

/// What makes a spool unusable although SQLite can read it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpoolDefect {
    /// An earlier process found the file broken and wrote down what it saw.
    #[error("{0}")]
    Condemned(String),
    /// The id of its stream cannot be read.
    #[error("{0:?} is no id of a stream")]
    StreamId(String),
    /// A chain has the wrong length.
    #[error("a chain has {0} bytes, not 16")]
    ChainLength(usize),
    /// The numbers of its batches contradict each other.
    #[error("it begins at batch {first}, was acknowledged up to {acknowledged} and ends at {newest}")]
    BatchNumbers {
        /// The first batch of the stream.
        first: i64,
        /// The last batch that the aggregator has.
        acknowledged: u64,
        /// The last batch that was written.
        newest: u64,
    },
}

impl SpoolError {
    /// Whether the file itself is broken: trying again, more rights or more room will not help.
    pub(super) fn is_damage(&self) -> bool {
        match self {
            Self::Damaged { .. } => true,
            Self::Open { source, .. } | Self::Migrate { source: MigrateError::Execute(source), .. } => {
                is_corrupt(source)
            }
            _ => false,
        }
    }

    /// Whether more room may help. SQLite is not always clear about it: where the index of the log has no place, it
    /// speaks of the file or of its input and output.
    pub(super) fn may_lack_room(&self) -> bool {
        matches!(
            self,
            Self::Open { source, .. } | Self::Migrate { source: MigrateError::Execute(source), .. }
                if matches!(code(source), Some(FULL | IO | CANNOT_OPEN))
        )
    }
}

/// Why something could not be done with a spool that is open.
#[derive(Debug, thiserror::Error)]
pub(in crate::outbox) enum Trouble {
    /// The path names another file or none: what is written now is lost when this process ends.
    #[error("the spool {} was deleted, moved or replaced while it was in use; put it back. A restart of the agent begins a new one, and what the old one held and was not stored is lost with it", .0.display())]
    Moved(PathBuf),
    /// The disk is full.
    #[error("cannot {action} the spool {}: the disk is full; free some room, it is tried again", .path.display())]
    Full {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
    },
    /// The file is broken.
    #[error("cannot {action} the spool {}: {source}; restart the agent, which then puts the file aside and begins a new one", .path.display())]
    Corrupt {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// SQLite's own words.
        source: sqlx::Error,
    },
    /// Anything else.
    #[error("cannot {action} the spool {}: {source}; check the disk and the file's permissions, it is tried again", .path.display())]
    Failed {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// SQLite's own words.
        source: sqlx::Error,
    },
}

impl Trouble {
    pub(super) fn new(action: &'static str, path: PathBuf, source: sqlx::Error) -> Self {
        match code(&source) {
            Some(FULL) => Self::Full { action, path },
            _ if is_corrupt(&source) => Self::Corrupt { action, path, source },
            _ => Self::Failed { action, path, source },
        }
    }
}

/// Whether SQLite says that the disk is full.
pub(super) fn is_full(error: &sqlx::Error) -> bool {
    code(error) == Some(FULL)
}

/// Whether SQLite says that the file itself is broken.
pub(super) fn is_corrupt(error: &sqlx::Error) -> bool {
    matches!(code(error), Some(CORRUPT | NOT_A_DATABASE))
}

/// SQLite's primary result code, if it was SQLite that failed.
fn code(error: &sqlx::Error) -> Option<i32> {
    let code: i32 = error.as_database_error()?.code()?.parse().ok()?;
    Some(code & 0xff)
}
