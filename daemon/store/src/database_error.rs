//! Errors of SQLite. Their type hides the SQL library from other crates.

use std::io;

use sqlx::migrate::MigrateError;

/// SQLite's codes for a file that is damaged or never was a database (SQLITE_CORRUPT, SQLITE_NOTADB).
const CORRUPT: i32 = 11;
const NOT_A_DATABASE: i32 = 26;

/// Returns whether an error means that the file itself is damaged or not a database.
pub(crate) fn is_damage(error: &sqlx::Error) -> bool {
    matches!(primary_code(error), Some(CORRUPT | NOT_A_DATABASE))
}

/// Returns whether an error means that a part of a database is damaged. Rows in other parts may then be salvaged.
pub(crate) fn is_partial_damage(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(CORRUPT)
}

/// Error of SQLite or of the operating system, with its text.
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
    // This is no implementation of `From`, because that would name the SQL library in the public interface.
    pub(crate) fn new(cause: impl Into<Cause>) -> Self {
        Self(cause.into())
    }

    /// Returns whether the file itself is damaged or was never a database.
    pub fn is_damage(&self) -> bool {
        self.statement().is_some_and(is_damage)
    }

    /// Returns a sentence part for people: what to do about a [transient](Self::is_transient) error.
    pub(crate) fn remedy(&self) -> &'static str {
        /// Primary result code.
        const FULL: i32 = 13;
        match self.statement().and_then(primary_code) {
            Some(FULL) => "free some space on its disk, or shorten [aggregator.retention]",
            _ => "end the program that locks it",
        }
    }

    /// Returns whether the error is transient: the database is full or locked by another program, and the same
    /// statement may succeed later.
    pub fn is_transient(&self) -> bool {
        /// Primary result codes: BUSY, LOCKED, FULL.
        const TRANSIENT: [i32; 3] = [5, 6, 13];
        self.statement().and_then(primary_code).is_some_and(|code| TRANSIENT.contains(&code))
    }

    fn statement(&self) -> Option<&sqlx::Error> {
        match &self.0 {
            Cause::Statement(error) | Cause::Migration(MigrateError::Execute(error)) => Some(error),
            Cause::Migration(_) => None,
        }
    }
}

/// Returns SQLite's primary result code.
pub(crate) fn primary_code(error: &sqlx::Error) -> Option<i32> {
    let code = error.as_database_error().and_then(|error| error.code());
    // Extended codes have the primary code in their lowest byte.
    Some(code?.parse::<i32>().ok()? & 0xff)
}
