//! The storage clock: the time during which an aggregator ran and stored into a database.
//!
//! Its reading is stored in the database and advances with the monotonic clock alone, so that no wall clock can make data old.

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use sqlx::SqliteConnection;

/// Longest advance for a time without a transaction: time in which the process was stopped or the database refused to store does
/// not count.
const LONGEST_ADVANCE: Span = Span::from_seconds(60);
/// Longest time between two stored readings. After `kill -9` the stored reading is behind by at most this time.
const STORE_EVERY: Span = Span::from_seconds(30);

const READ: &str = "SELECT elapsed_ns FROM storage_clock";
/// ?1 time since the last advance, ?2 the wall clock. Creates the row in a file that lost it.
const ADVANCE: &str = "INSERT INTO storage_clock (id, elapsed_ns, wall_ns) VALUES (1, ?1, ?2) \
     ON CONFLICT (id) DO UPDATE SET elapsed_ns = elapsed_ns + excluded.elapsed_ns, wall_ns = excluded.wall_ns \
     RETURNING elapsed_ns";

/// The part of the reading that is not yet in the database.
#[derive(Debug, Default)]
pub(crate) struct StorageClock {
    /// Time up to which the stored reading is complete. `None` before the first transaction: no earlier time counts.
    advanced: Option<MonoTime>,
}

impl StorageClock {
    /// Returns its reading now.
    pub(crate) async fn read(
        &self,
        connection: &mut SqliteConnection,
        now: MonoTime,
    ) -> Result<Span, sqlx::Error> {
        let stored: Option<i64> = sqlx::query_scalar(READ).fetch_optional(connection).await?;
        Ok(Span::from_nanos(stored.unwrap_or(0)) + self.elapsed(now))
    }

    /// Advances it within a transaction and returns its reading. [`Self::committed`] has to follow the commit.
    pub(crate) async fn advance(
        &self,
        connection: &mut SqliteConnection,
        now: Stamp,
    ) -> Result<Span, sqlx::Error> {
        let advanced = sqlx::query_scalar(ADVANCE)
            .bind(self.elapsed(now.mono).nanos())
            .bind(now.wall.unix_nanos())
            .fetch_one(connection)
            .await?;
        Ok(Span::from_nanos(advanced))
    }

    /// Records that the transaction that advanced it was committed.
    pub(crate) fn committed(&mut self, now: MonoTime) {
        self.advanced = self.advanced.max(Some(now));
    }

    /// Returns whether the reading has to be stored although nothing else is to be stored.
    pub(crate) fn is_due(&self, now: MonoTime) -> bool {
        self.advanced.is_none_or(|advanced| now - advanced >= STORE_EVERY)
    }

    fn elapsed(&self, now: MonoTime) -> Span {
        let elapsed = self.advanced.map_or(Span::ZERO, |advanced| now - advanced);
        elapsed.clamp(Span::ZERO, LONGEST_ADVANCE)
    }
}

/// Returns the aggregator's wall clock at the last commit, or `None` if there was none.
pub(super) async fn last_wall(connection: &mut SqliteConnection) -> Result<Option<WallTime>, sqlx::Error> {
    let wall: Option<Option<i64>> =
        sqlx::query_scalar("SELECT wall_ns FROM storage_clock").fetch_optional(connection).await?;
    Ok(wall.flatten().map(WallTime::from_unix_nanos))
}

#[cfg(test)]
pub(crate) const STATEMENTS: [(&str, &str); 2] = [("STORAGE_CLOCK", READ), ("ADVANCE", ADVANCE)];
