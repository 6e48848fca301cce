//! Incidents and log lines about deleted data. Retention creates at most one incident per hour, and updates its text at
//! each deletion: an incident per transaction would displace all other incidents of the aggregator.

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write;

use peernet_clock::WallTime;
use sqlx::SqliteConnection;

use super::Kind;
use crate::incidents;
use crate::retention_config::RetentionConfig;
use crate::types::AggregatorIncidentKind;

/// Time for which an incident is updated, seconds of the storage clock.
const INCIDENT_PERIOD_S: i64 = 3_600;

/// ?1 incident, ?2 text.
const UPDATE: &str = "UPDATE incident SET text = ?2 WHERE id = ?1";

/// Reason for which retention deleted data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Cause {
    /// The data was older than its retention period.
    Age,
    /// The database was larger than the size limit.
    Size,
}

/// Amount of data that a transaction deleted from a run or link.
#[derive(Clone, Copy, Debug)]
pub(super) struct Deletion {
    pub(super) cause: Cause,
    pub(super) kind: Kind,
    /// Number of a run, or id of a link.
    pub(super) owner: i64,
    /// Number of iterations, rows of statistics, or clock samples.
    pub(super) items: u64,
}

/// The incident of the current hour, with its deletions.
#[derive(Debug)]
pub(super) struct Deletions {
    config: RetentionConfig,
    current: Option<HourlyIncident>,
}

/// An incident about the deletions of one hour.
#[derive(Debug)]
struct HourlyIncident {
    /// Id of the incident in the database.
    id: i64,
    /// Start of the hour on the storage clock, seconds.
    from_s: i64,
    deleted: BTreeMap<(Cause, Kind), DeletedData>,
    /// The text that was last written to the log; `None` if none was written.
    logged_text: Option<String>,
}

/// Deleted data of one cause and kind.
#[derive(Debug, Default)]
struct DeletedData {
    items: u64,
    // A set, because several transactions of the hour may delete data of the same owner.
    owners: HashSet<i64>,
}

impl Deletions {
    pub(super) const fn new(config: RetentionConfig) -> Self {
        Self { config, current: None }
    }

    /// Records the deletions of this transaction in the incident.
    pub(super) async fn record(
        &mut self,
        connection: &mut SqliteConnection,
        deletions: &[Deletion],
        (now_s, now): (i64, WallTime),
    ) -> Result<(), sqlx::Error> {
        if deletions.is_empty() {
            return Ok(());
        }
        self.finish_if_old(now_s);
        // The incident is taken out: if a statement fails, the transaction is rolled back, and the incident must not be
        // used again.
        let mut current = match self.current.take() {
            Some(current) => current,
            None => {
                let kind = AggregatorIncidentKind::Retention;
                let id = incidents::record(connection, kind, now, "").await?;
                HourlyIncident { id, from_s: now_s, deleted: BTreeMap::new(), logged_text: None }
            }
        };
        for Deletion { cause, kind, owner, items } in deletions {
            let deleted = current.deleted.entry((*cause, *kind)).or_default();
            deleted.items += items;
            deleted.owners.insert(*owner);
        }
        let text = current.description(&self.config);
        sqlx::query(UPDATE).bind(current.id).bind(text).execute(connection).await?;
        self.current = Some(current);
        Ok(())
    }

    /// Forgets the incident, because the transaction was rolled back. Later deletions become another incident.
    pub(super) fn forget(&mut self) {
        self.current = None;
    }

    /// Logs deletions when nothing remains to be deleted: the first deletions of an hour at the first such time, and
    /// all deletions of the hour at its end.
    pub(super) fn log_when_idle(&mut self, now_s: i64) {
        if let Some(current) = &mut self.current
            && current.logged_text.is_none()
        {
            current.log(&self.config);
        }
        self.finish_if_old(now_s);
    }

    /// Ends the current incident, and logs its deletions that were not logged yet.
    pub(super) fn finish(&mut self) {
        if let Some(mut current) = self.current.take() {
            current.log(&self.config);
        }
    }

    /// Ends the current incident if its hour is over.
    fn finish_if_old(&mut self, now_s: i64) {
        if self.current.as_ref().is_some_and(|current| now_s - current.from_s >= INCIDENT_PERIOD_S) {
            self.finish();
        }
    }
}

impl HourlyIncident {
    fn log(&mut self, config: &RetentionConfig) {
        let text = self.description(config);
        // The text changes with each deletion. If it is unchanged, nothing was deleted since the last line.
        if self.logged_text.as_ref() != Some(&text) {
            tracing::info!("retention {text}");
            self.logged_text = Some(text);
        }
    }

    fn description(&self, config: &RetentionConfig) -> String {
        let mut text = "deleted".to_owned();
        let mut last_cause = None;
        for ((cause, kind), DeletedData { items, owners }) in &self.deleted {
            let separator = match last_cause {
                None => " ",
                Some(last_cause) if last_cause == cause => ", ",
                Some(_) => "; ",
            };
            last_cause = Some(cause);
            let owners = owners.len();
            let plural = if owners == 1 { "" } else { "s" };
            let (what, owner) = (kind.description(), kind.owner_description());
            // Writing to a string cannot fail.
            let _ = write!(text, "{separator}{items} {what} of {owners} {owner}{plural}");
            let _ = match cause {
                Cause::Age => write!(text, " ({} = {})", kind.key(), kind.days(config)),
                Cause::Size => write!(text, " (size_limit_bytes = {})", config.size_limit_bytes),
            };
        }
        text
    }
}

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 1] = [("UPDATE_INCIDENT", UPDATE)];
