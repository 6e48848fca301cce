//! Incidents of the aggregator itself.

use peernet_clock::{Stamp, WallTime};
use sqlx::SqliteConnection;

use super::wall_clock::WallClockWatch;
use crate::types::AggregatorIncidentKind;

/// Incidents of the aggregator that are kept: more than a year of one an hour.
const KEPT: i64 = 10_000;
/// Incidents that wait while the database cannot be written; the first ones say most.
const MOST_PENDING: usize = 64;

const INSERT: &str = "INSERT INTO incident (host, at_ns, kind, text) VALUES (NULL, ?1, ?2, ?3)";
/// ?1 how many are kept.
const DELETE_OLDEST: &str = "DELETE FROM incident WHERE host IS NULL AND id <= \
     (SELECT id FROM incident WHERE host IS NULL ORDER BY id DESC LIMIT 1 OFFSET ?1)";

/// Stores an incident of the aggregator itself and returns its id; the newest [`KEPT`] stay.
pub(crate) async fn record(
    connection: &mut SqliteConnection,
    kind: AggregatorIncidentKind,
    at: WallTime,
    text: &str,
) -> Result<i64, sqlx::Error> {
    let inserted = sqlx::query(INSERT).bind(at.unix_nanos()).bind(kind.name()).bind(text);
    let id = inserted.execute(&mut *connection).await?.last_insert_rowid();
    sqlx::query(DELETE_OLDEST).bind(KEPT).execute(connection).await?;
    Ok(id)
}

/// Incidents of the aggregator that wait to be stored, within a second or when the database can be written again. They
/// outlive a database that is opened anew.
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
    /// Begins to watch the wall clock.
    pub const fn new(now: Stamp) -> Self {
        Self { wall_clock: WallClockWatch::new(now), waiting: Vec::new() }
    }

    /// Takes an incident.
    pub fn add(&mut self, kind: AggregatorIncidentKind, at: WallTime, text: String) {
        if self.waiting.len() < MOST_PENDING {
            self.waiting.push(PendingIncident { kind, at, text });
        }
    }

    /// Looks whether the wall clock was stepped since the last look.
    pub(super) fn look(&mut self, now: Stamp) {
        let step = self.wall_clock.look(now);
        self.add_step(step, now);
    }

    /// Looks whether the wall clock is behind what it showed when something was last stored.
    pub(super) fn compare(&mut self, now: Stamp, last_stored: WallTime) {
        self.add_step(WallClockWatch::compare(now, last_stored), now);
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Stores them within a transaction; [`Self::clear`] has to follow.
    pub(super) async fn store(&self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        for PendingIncident { kind, at, text } in &self.waiting {
            record(connection, *kind, *at, text).await?;
        }
        Ok(())
    }

    /// They are stored.
    pub(super) fn clear(&mut self) {
        self.waiting.clear();
    }

    fn add_step(&mut self, step: Option<String>, now: Stamp) {
        if let Some(text) = step {
            tracing::warn!("{text}; nothing is deleted because of it, set the clock right");
            self.add(AggregatorIncidentKind::ClockStep, now.wall, text);
        }
    }
}

#[cfg(test)]
pub(crate) const STATEMENTS: [(&str, &str); 2] =
    [("INSERT_INCIDENT", INSERT), ("DELETE_OLDEST_INCIDENTS", DELETE_OLDEST)];
