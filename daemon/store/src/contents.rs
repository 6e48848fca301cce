//! Whose file it is, by its tables.

use sqlx::SqliteConnection;

/// What an SQLite file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contents {
    /// Nothing yet.
    Nothing,
    /// What an aggregator stored.
    Database,
    /// What waits on an agent.
    Spool,
    /// Something of another program.
    Other,
}

/// Tables: all but those that note migrations, and of them those of the aggregator and of a spool.
const TABLES: &str = "SELECT count(*), coalesce(sum(name IN ('host', 'run', 'iteration')), 0), \
     coalesce(sum(name IN ('stream', 'batch', 'reached', 'unreported', 'unresolved')), 0) \
     FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE '\\_%' ESCAPE '\\' AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\'";

impl Contents {
    /// Looks at a file.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(crate) async fn of(connection: &mut SqliteConnection) -> Result<Self, sqlx::Error> {
        let (all, database, spool): (i64, i64, i64) = sqlx::query_as(TABLES).fetch_one(connection).await?;
        Ok(match (all, database, spool) {
            (0, ..) => Self::Nothing,
            (_, 3, _) => Self::Database,
            // Fewer in one of an earlier version.
            (3..=5, _, spool) if spool == all => Self::Spool,
            _ => Self::Other,
        })
    }

    /// What it is where an aggregator's database was expected; `None` where it is one.
    pub(crate) fn instead_of_database(self) -> Option<&'static str> {
        match self {
            Self::Database => None,
            Self::Nothing => Some("an empty file"),
            Self::Spool => Some("an agent's spool"),
            Self::Other => Some("the database of another program"),
        }
    }
}
