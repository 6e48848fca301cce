//! What SQLite refuses, without the names of the library that asks it.

use std::io;

use sqlx::migrate::MigrateError;

/// SQLite's codes for a file that is damaged or never was a database (SQLITE_CORRUPT, SQLITE_NOTADB).
const CORRUPT: i32 = 11;
const NOT_A_DATABASE: i32 = 26;

/// Whether an error says that the file itself is wrong.
pub(crate) fn is_damage(error: &sqlx::Error) -> bool {
    matches!(primary_code(error), Some(CORRUPT | NOT_A_DATABASE))
}

/// Whether an error says that the file is a database of which a part is damaged, so that the rest may be salvaged.
pub(crate) fn is_partial_damage(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(CORRUPT)
}

/// What SQLite, or the system beneath it, cannot do; the text is in its own words.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct DatabaseError(Cause);

#[derive(Debug, thiserror::Error)]
pub(crate) enum Cause {
    #[error(transparent)]
    Statement(#[from] sqlx::Error),
    #[error(transparent)]
    Migration(#[from] MigrateError),
}

impl From<io::Error> for Cause {
    fn from(error: io::Error) -> Self {
        Self::Statement(error.into())
    }
}

impl DatabaseError {
    // No `From`: the library would be named in what other crates see.
    pub(crate) fn new(cause: impl Into<Cause>) -> Self {
        Self(cause.into())
    }

    /// Whether the file itself is damaged or was never a database.
    pub fn is_damage(&self) -> bool {
        self.statement().is_some_and(is_damage)
    }

    /// Whether the database is full or another program locks it: the same statement may succeed later.
    pub fn is_passing(&self) -> bool {
        /// Primary result codes: BUSY, LOCKED, FULL.
        const PASSING: [i32; 3] = [5, 6, 13];
        self.statement().and_then(primary_code).is_some_and(|code| PASSING.contains(&code))
    }

    fn statement(&self) -> Option<&sqlx::Error> {
        match &self.0 {
            Cause::Statement(error) | Cause::Migration(MigrateError::Execute(error)) => Some(error),
            Cause::Migration(_) => None,
        }
    }
}

/// SQLite's primary result code.
pub(crate) fn primary_code(error: &sqlx::Error) -> Option<i32> {
    let code = error.as_database_error().and_then(|error| error.code());
    // Extended codes have the primary one in their lowest byte.
    Some(code?.parse::<i32>().ok()? & 0xff)
}
