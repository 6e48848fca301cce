//! Incidents of the aggregator itself.

use peernet_clock::{Stamp, WallTime};
use sqlx::SqliteConnection;

use super::wall_clock::WallClockWatch;
use crate::types::AggregatorIncidentKind;

/// Maximum number of stored incidents of the aggregator. With one incident per hour, this number covers more than a
/// year.
const MAX_STORED: i64 = 10_000;
/// Number of incidents that may wait while the database cannot be written. Later incidents are dropped, because the
/// first incidents are the closest to the cause.
const MAX_PENDING: usize = 64;

const INSERT: &str = "INSERT INTO incident (host, at_ns, kind, text) VALUES (NULL, ?1, ?2, ?3)";
/// ?1 number of incidents to keep.
const DELETE_OLDEST: &str = "DELETE FROM incident WHERE host IS NULL AND id <= \
     (SELECT id FROM incident WHERE host IS NULL ORDER BY id DESC LIMIT 1 OFFSET ?1)";

/// Stores an incident of the aggregator itself and returns the id of the incident. Deletes all incidents of the
/// aggregator except the newest [`MAX_STORED`].
pub(crate) async fn record(
    connection: &mut SqliteConnection,
    kind: AggregatorIncidentKind,
    at: WallTime,
    text: &str,
) -> Result<i64, sqlx::Error> {
    let query = sqlx::query(INSERT).bind(at.unix_nanos()).bind(kind.name()).bind(text);
    let id = query.execute(&mut *connection).await?.last_insert_rowid();
    sqlx::query(DELETE_OLDEST).bind(MAX_STORED).execute(connection).await?;
    Ok(id)
}

/// Incidents of the aggregator that wait to be stored. They are stored within a second, or as soon as the database can
/// be written, and are kept while the database is reopened.
#[derive(Debug)]
pub struct PendingIncidents {
    wall_clock: WallClockWatch,
    waiting: Vec<PendingIncident>,
}

#[derive(Debug)]
struct PendingIncident {
    kind: AggregatorIncidentKind,
    at: WallTime,
    text: String,
}

impl PendingIncidents {
    /// Starts watching the wall clock.
    pub const fn new(now: Stamp) -> Self {
        Self { wall_clock: WallClockWatch::new(now), waiting: Vec::new() }
    }

    /// Adds an incident, or drops the incident if too many are waiting.
    pub fn add(&mut self, kind: AggregatorIncidentKind, at: WallTime, text: String) {
        if self.waiting.len() < MAX_PENDING {
            self.waiting.push(PendingIncident { kind, at, text });
        }
    }

    /// Adds an incident if the wall clock was stepped since the last call.
    pub(super) fn check_step(&mut self, now: Stamp) {
        let step = self.wall_clock.check_step(now);
        self.add_step(step, now);
    }

    /// Adds an incident if the wall clock is behind its reading at the last commit.
    pub(super) fn compare_with_last_commit(&mut self, now: Stamp, last_stored: WallTime) {
        self.add_step(WallClockWatch::compare_with_last_commit(now, last_stored), now);
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Stores all pending incidents within a transaction. [`Self::clear`] has to be called after the commit.
    pub(super) async fn store(&self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        for PendingIncident { kind, at, text } in &self.waiting {
            record(connection, *kind, *at, text).await?;
        }
        Ok(())
    }

    /// Removes all pending incidents after their transaction was committed.
    pub(super) fn clear(&mut self) {
        self.waiting.clear();
    }

    fn add_step(&mut self, step: Option<String>, now: Stamp) {
        if let Some(text) = step {
            tracing::warn!("{text}; no data is deleted early because of this step; correct the clock");
            self.add(AggregatorIncidentKind::ClockStep, now.wall, text);
        }
    }
}

#[cfg(test)]
pub(crate) const STATEMENTS: [(&str, &str); 2] =
    [("INSERT_INCIDENT", INSERT), ("DELETE_OLDEST_INCIDENTS", DELETE_OLDEST)];
