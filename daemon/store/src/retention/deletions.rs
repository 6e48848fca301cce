//! Incidents and log lines about deleted data. There is at most one incident per hour, whose text is updated.

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write;

use peernet_clock::WallTime;
use sqlx::SqliteConnection;

use super::Kind;
use crate::incidents;
use crate::retention_config::RetentionConfig;
use crate::types::AggregatorIncidentKind;

/// Time on the storage clock for which an incident is updated.
const GROUP_S: i64 = 3_600;

/// ?1 incident, ?2 text.
const UPDATE: &str = "UPDATE incident SET text = ?2 WHERE id = ?1";

/// Limit that made retention delete data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Cause {
    /// The data was older than its period.
    Age,
    /// The database was larger than its limit.
    Size,
}

/// Amount of data of a run or link that a transaction deleted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Deletion {
    pub(super) cause: Cause,
    pub(super) kind: Kind,
    /// Number of a run, or id of a link.
    pub(super) owner: i64,
    /// Number of iterations, rows of statistics, or samples.
    pub(super) items: u64,
}

/// The incident of the current hour, and the deletions in it.
#[derive(Debug)]
pub(super) struct Deletions {
    config: RetentionConfig,
    group: Option<Group>,
}

/// Contents of one incident.
#[derive(Debug)]
struct Group {
    /// Id of the incident.
    incident: i64,
    /// Start of the group on the storage clock, seconds.
    from_s: i64,
    counts: BTreeMap<(Cause, Kind), Count>,
    /// The last text written to the log.
    logged_text: Option<String>,
}

/// Deleted data of one cause and kind.
#[derive(Debug, Default)]
struct Count {
    items: u64,
    owners: HashSet<i64>,
}

impl Deletions {
    pub(super) const fn new(config: RetentionConfig) -> Self {
        Self { config, group: None }
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
        // Taken out: if a statement fails, the transaction is rolled back and the group must not be used again.
        let mut group = match self.group.take() {
            Some(group) => group,
            None => {
                let kind = AggregatorIncidentKind::Retention;
                let incident = incidents::record(connection, kind, now, "").await?;
                Group { incident, from_s: now_s, counts: BTreeMap::new(), logged_text: None }
            }
        };
        for Deletion { cause, kind, owner, items } in deletions {
            let count = group.counts.entry((*cause, *kind)).or_default();
            count.items += items;
            count.owners.insert(*owner);
        }
        let text = group.description(&self.config);
        sqlx::query(UPDATE).bind(group.incident).bind(text).execute(connection).await?;
        self.group = Some(group);
        Ok(())
    }

    /// Forgets the incident, because the transaction was rolled back. Later deletions become another incident.
    pub(super) fn forget(&mut self) {
        self.group = None;
    }

    /// Logs deletions while no data is to be deleted: the first deletions of an hour at once, and all deletions of the
    /// hour at its end.
    pub(super) fn log_when_idle(&mut self, now_s: i64) {
        if let Some(group) = &mut self.group
            && group.logged_text.is_none()
        {
            group.log(&self.config);
        }
        self.finish_if_old(now_s);
    }

    /// Logs the deletions that were not logged yet, because no more deletions follow.
    pub(super) fn finish(&mut self) {
        if let Some(mut group) = self.group.take() {
            group.log(&self.config);
        }
    }

    fn finish_if_old(&mut self, now_s: i64) {
        if self.group.as_ref().is_some_and(|group| now_s - group.from_s >= GROUP_S) {
            self.finish();
        }
    }
}

impl Group {
    fn log(&mut self, config: &RetentionConfig) {
        let text = self.description(config);
        // Nothing was deleted since the last line.
        if self.logged_text.as_ref() != Some(&text) {
            tracing::info!("retention {text}");
            self.logged_text = Some(text);
        }
    }

    fn description(&self, config: &RetentionConfig) -> String {
        let mut text = "deleted".to_owned();
        let mut last_cause = None;
        for ((cause, kind), Count { items, owners }) in &self.counts {
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
