//! Recognition of an SQLite file by its tables.

use sqlx::SqliteConnection;

/// Kind of an SQLite file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// An empty file.
    Empty,
    /// An aggregator's database.
    Database,
    /// An agent's spool.
    Spool,
    /// The database of another program.
    Other,
}

/// Selects three numbers: of all tables, of the tables that only an aggregator's database has, and of the tables that
/// only a spool has. Tables of SQLite (`sqlite_…`) and the table of migrations (`_…`) do not count.
const TABLES: &str = "SELECT count(*), coalesce(sum(name IN ('host', 'run', 'iteration')), 0), \
     coalesce(sum(name IN ('stream', 'batch', 'reached', 'unreported', 'unresolved')), 0) \
     FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE '\\_%' ESCAPE '\\' AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\'";

impl FileKind {
    /// Returns the kind of the opened file.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub(crate) async fn detect(connection: &mut SqliteConnection) -> Result<Self, sqlx::Error> {
        let (all_tables, database_tables, spool_tables): (i64, i64, i64) =
            sqlx::query_as(TABLES).fetch_one(connection).await?;
        Ok(match (all_tables, database_tables, spool_tables) {
            (0, ..) => Self::Empty,
            (_, 3, _) => Self::Database,
            // A spool of an earlier version has fewer tables.
            (3..=5, _, spool_tables) if spool_tables == all_tables => Self::Spool,
            _ => Self::Other,
        })
    }

    /// Returns what the file is instead of an aggregator's database; `None` if the file is an aggregator's database.
    pub(crate) fn other_kind(self) -> Option<&'static str> {
        match self {
            Self::Database => None,
            Self::Empty => Some("an empty file"),
            Self::Spool => Some("an agent's spool"),
            Self::Other => Some("the database of another program"),
        }
    }
}
