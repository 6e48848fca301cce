//! The table `trimmed`. For each run and kind of data, the table has the time before which data is incomplete, because
//! retention deleted some of it. Queries and a rebuild read this table.

use sqlx::SqliteConnection;

use super::Kind;

/// Inserts or advances the time of a run and kind: ?1 run, ?2 kind, ?3 second.
const TRIMMED: &str = "INSERT INTO trimmed (run, kind, before_s) VALUES (?1, ?2, ?3) \
     ON CONFLICT DO UPDATE SET before_s = max(before_s, excluded.before_s)";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 1] = [("TRIMMED", TRIMMED)];

/// Records that some data of this kind that began before `before_s` is deleted.
pub(super) async fn record_trimmed(
    connection: &mut SqliteConnection,
    kind: Kind,
    run: i64,
    before_s: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query(TRIMMED).bind(run).bind(kind.number()).bind(before_s).execute(connection).await?;
    Ok(())
}
