//! The storage clock counts the time during which an aggregator ran and stored into a database.
//!
//! The reading of the storage clock is stored in the database. The storage clock advances only with the monotonic
//! clock, so that a wrong wall clock cannot make data appear old.

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use sqlx::SqliteConnection;

/// Longest advance between two transactions. If more time passes, the rest does not count: the process was suspended,
/// or the database could not be written.
const LONGEST_ADVANCE: Span = Span::from_seconds(60);
/// Longest time between two stored readings. After `kill -9`, the stored reading lacks at most this time.
const STORE_INTERVAL: Span = Span::from_seconds(30);

const READ: &str = "SELECT elapsed_ns FROM storage_clock";
/// Advances the stored reading: ?1 time since the last advance, ?2 the wall clock. Creates the row if it is missing.
const ADVANCE: &str = "INSERT INTO storage_clock (id, elapsed_ns, wall_ns) VALUES (1, ?1, ?2) \
     ON CONFLICT (id) DO UPDATE SET elapsed_ns = elapsed_ns + excluded.elapsed_ns, wall_ns = excluded.wall_ns \
     RETURNING elapsed_ns";

/// The part of the storage clock that is only in memory: the time since the last stored reading.
#[derive(Debug, Default)]
pub(crate) struct StorageClock {
    /// Time of the last transaction, up to which the stored reading is complete. `None` before the first transaction of
    /// this process; time before it does not count.
    advanced_at: Option<MonoTime>,
}

impl StorageClock {
    /// Returns the current reading.
    pub(crate) async fn read(
        &self,
        connection: &mut SqliteConnection,
        now: MonoTime,
    ) -> Result<Span, sqlx::Error> {
        let stored: Option<i64> = sqlx::query_scalar(READ).fetch_optional(connection).await?;
        Ok(Span::from_nanos(stored.unwrap_or(0)) + self.elapsed(now))
    }

    /// Advances the stored reading within a transaction and returns it. [`Self::record_commit`] has to be called after
    /// the commit.
    pub(crate) async fn advance(
        &self,
        connection: &mut SqliteConnection,
        now: Stamp,
    ) -> Result<Span, sqlx::Error> {
        let reading = sqlx::query_scalar(ADVANCE)
            .bind(self.elapsed(now.mono).nanos())
            .bind(now.wall.unix_nanos())
            .fetch_one(connection)
            .await?;
        Ok(Span::from_nanos(reading))
    }

    /// Records that the transaction that advanced the stored reading was committed.
    pub(crate) fn record_commit(&mut self, now: MonoTime) {
        self.advanced_at = self.advanced_at.max(Some(now));
    }

    /// Returns whether the reading has to be stored now, even if nothing else is to be stored.
    pub(crate) fn is_due(&self, now: MonoTime) -> bool {
        self.advanced_at.is_none_or(|advanced_at| now - advanced_at >= STORE_INTERVAL)
    }

    /// Returns the time since the last transaction, but at most `LONGEST_ADVANCE`.
    fn elapsed(&self, now: MonoTime) -> Span {
        let elapsed = self.advanced_at.map_or(Span::ZERO, |advanced_at| now - advanced_at);
        elapsed.clamp(Span::ZERO, LONGEST_ADVANCE)
    }
}

/// Returns the reading of the aggregator's wall clock at the last commit, or `None` if nothing was committed yet.
pub(super) async fn wall_at_last_commit(
    connection: &mut SqliteConnection,
) -> Result<Option<WallTime>, sqlx::Error> {
    // The outer `None` means no row, and the inner `None` means a row without a time.
    let wall: Option<Option<i64>> =
        sqlx::query_scalar("SELECT wall_ns FROM storage_clock").fetch_optional(connection).await?;
    Ok(wall.flatten().map(WallTime::from_unix_nanos))
}

#[cfg(test)]
pub(crate) const STATEMENTS: [(&str, &str); 2] = [("STORAGE_CLOCK", READ), ("ADVANCE", ADVANCE)];
