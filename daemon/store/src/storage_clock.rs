//! The storage clock: how long an aggregator has run and stored into a database. Its reading stands in the database and
//! is advanced from the monotonic clock alone, so that no wall clock can make data old.

use peernet_clock::{MonoTime, Span, Stamp, WallTime};
use sqlx::SqliteConnection;

/// A stretch without any transaction counts for at most so long: a process that was stopped, or whose database refused to
/// store, was not storing.
const LONGEST_ADVANCE: Span = Span::from_seconds(60);
/// Without other transactions the clock is stored so often: after `kill -9` it lacks at most as much.
const STORE_EVERY: Span = Span::from_seconds(30);

const READ: &str = "SELECT elapsed_ns FROM storage_clock";
/// ?1 elapsed since the last time, ?2 the wall clock. Makes the row in a file that lost it.
const ADVANCE: &str = "INSERT INTO storage_clock (id, elapsed_ns, wall_ns) VALUES (1, ?1, ?2) \
     ON CONFLICT (id) DO UPDATE SET elapsed_ns = elapsed_ns + excluded.elapsed_ns, wall_ns = excluded.wall_ns \
     RETURNING elapsed_ns";

/// Advances the reading that stands in the database.
#[derive(Debug, Default)]
pub(crate) struct StorageClock {
    /// Up to this moment the database's reading is complete. `None`: no time counts before the first transaction.
    advanced: Option<MonoTime>,
}

impl StorageClock {
    /// Its reading now.
    pub(crate) async fn read(
        &self,
        connection: &mut SqliteConnection,
        now: MonoTime,
    ) -> Result<Span, sqlx::Error> {
        let stored: Option<i64> = sqlx::query_scalar(READ).fetch_optional(connection).await?;
        Ok(Span::from_nanos(stored.unwrap_or(0)) + self.elapsed(now))
    }

    /// Advances it within a transaction, and returns its reading; [`Self::committed`] has to follow.
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

    /// The transaction that advanced it was committed.
    pub(crate) fn committed(&mut self, now: MonoTime) {
        self.advanced = self.advanced.max(Some(now));
    }

    /// Whether it has to be stored although nothing else is.
    pub(crate) fn is_due(&self, now: MonoTime) -> bool {
        self.advanced.is_none_or(|advanced| now - advanced >= STORE_EVERY)
    }

    fn elapsed(&self, now: MonoTime) -> Span {
        let elapsed = self.advanced.map_or(Span::ZERO, |advanced| now - advanced);
        elapsed.clamp(Span::ZERO, LONGEST_ADVANCE)
    }
}

/// The aggregator's wall clock when it last stored something; `None`: never.
pub(super) async fn last_wall(connection: &mut SqliteConnection) -> Result<Option<WallTime>, sqlx::Error> {
    let wall: Option<Option<i64>> =
        sqlx::query_scalar("SELECT wall_ns FROM storage_clock").fetch_optional(connection).await?;
    Ok(wall.flatten().map(WallTime::from_unix_nanos))
}

#[cfg(test)]
pub(crate) const STATEMENTS: [(&str, &str); 2] = [("STORAGE_CLOCK", READ), ("ADVANCE", ADVANCE)];
