//! Transactions on a connection that stays usable even if SQLite rolls a transaction back by itself.
//!
//! SQLite rolls a transaction back by itself when the disk is full, for example. sqlx's `Transaction` still considers
//! the transaction open and cannot begin another transaction on this connection. Therefore the functions here send the
//! statements `BEGIN`, `COMMIT` and `ROLLBACK` themselves.

use sqlx::SqliteConnection;

/// Begins a transaction that writes.
pub(crate) async fn begin(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    // After a plain BEGIN, the first write takes the write lock. If another connection has written since the first
    // read, that write would fail at once, without waiting for the lock.
    sqlx::query("BEGIN IMMEDIATE").execute(connection).await.map(drop)
}

/// Commits the transaction.
pub(crate) async fn commit(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    sqlx::query("COMMIT").execute(connection).await.map(drop)
}

/// Rolls back a transaction if there is one.
pub(crate) async fn roll_back(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    /// SQLITE_ERROR: no transaction is open. The transaction did not begin, or SQLite rolled it back by itself.
    const NO_TRANSACTION: &str = "1";
    match sqlx::query("ROLLBACK").execute(connection).await {
        Err(error)
            if error.as_database_error().and_then(|error| error.code()).as_deref()
                != Some(NO_TRANSACTION) =>
        {
            Err(error)
        }
        _ => Ok(()),
    }
}
