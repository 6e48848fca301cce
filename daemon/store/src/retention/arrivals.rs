//! The table `arrival` records when each range of data arrived, which shows the data that has to be deleted next. The
//! owner of data is a run or a link.
//!
//! If a later row of the same owner covers a part of a row's range, that part is kept until the later row is due.
//! Ranges overlap, for example, if a robot's clock jumps back during a run. Because of this rule, such a jump deletes
//! no data early.

use sqlx::SqliteConnection;

use super::deletions::{Cause, Deletion};
use super::{DeletedRows, Kind, buckets, clocks, nodes};
use crate::extent::Extent;
use crate::rollups::bucket;

/// Maximum number of rows of the table `arrival` that are handled per transaction.
const MAX_ROWS: usize = 64;

/// Pins or unpins a run; triggers then update the table `arrival`: ?1 run, ?2 1 to pin, 0 to unpin.
const PIN: &str = "UPDATE run SET pinned = ?2 WHERE number = ?1";
/// Inserts a row that covers all data of a kind of a run. The retention period of this data begins now. ?1 kind, ?2
/// run.
const BEGIN_PERIOD: &str = "INSERT INTO arrival (kind, owner, from_s, to_s, first, last) \
     SELECT ?1, number, 0, coalesce((SELECT elapsed_ns / 1000000000 FROM storage_clock), 0), \
       -9223372036854775808, 9223372036854775807 FROM run WHERE number = ?2 AND pinned = 0 \
     ON CONFLICT (kind, owner, from_s) DO UPDATE SET to_s = excluded.to_s, first = excluded.first, last = excluded.last";
/// The row of a kind whose retention period began first, if it began at a second of the storage clock or before: ?1
/// kind, ?2 second.
const NEXT: &str =
    "SELECT owner, from_s, first, last FROM arrival WHERE kind = ?1 AND to_s <= ?2 ORDER BY to_s LIMIT 1";
/// Ranges of the later rows that overlap a row: ?1 kind, ?2 owner, ?3 `from_s` of the row, ?4 and ?5 first and last
/// number of the row's range.
const LATER: &str = "SELECT first, last FROM arrival WHERE kind = ?1 AND owner = ?2 AND from_s > ?3 \
     AND first <= ?5 AND last >= ?4";
/// Ranges of a run's data whose arrival is not in the table `arrival` yet: ?1 run.
const ARRIVING_RUN: &str = "SELECT arriving_first_number, arriving_last_number, arriving_first_s, arriving_last_s \
     FROM run WHERE number = ?1 AND arriving_from_s IS NOT NULL";
/// Range of a link's data whose arrival is not in the table `arrival` yet: ?1 link.
const ARRIVING_LINK: &str =
    "SELECT arriving_first_ns, arriving_last_ns FROM link WHERE id = ?1 AND arriving_from_s IS NOT NULL";
/// Removes a row: ?1 kind, ?2 owner, ?3 `from_s`.
const REMOVE: &str = "DELETE FROM arrival WHERE kind = ?1 AND owner = ?2 AND from_s = ?3";
/// Begins the retention period of a row again: ?1 kind, ?2 owner, ?3 `from_s`, ?4 now.
const POSTPONE: &str = "UPDATE arrival SET to_s = ?4 WHERE kind = ?1 AND owner = ?2 AND from_s = ?3";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 8] = [
    ("PIN", PIN),
    ("BEGIN_PERIOD", BEGIN_PERIOD),
    ("NEXT", NEXT),
    ("LATER", LATER),
    ("ARRIVING_RUN", ARRIVING_RUN),
    ("ARRIVING_LINK", ARRIVING_LINK),
    ("REMOVE", REMOVE),
    ("POSTPONE", POSTPONE),
];

/// Pins or unpins a run. No data of a pinned run is deleted; data that was deleted before stays deleted. The retention
/// periods of an unpinned run begin now. Returns whether the run exists.
pub(crate) async fn pin(
    connection: &mut SqliteConnection,
    run: i64,
    pinned: bool,
) -> Result<bool, sqlx::Error> {
    let result = sqlx::query(PIN).bind(run).bind(pinned).execute(connection).await?;
    Ok(result.rows_affected() > 0)
}

/// Begins the retention period of all stored data of one kind of a run, unless the run is pinned.
pub(crate) async fn begin_retention_period(
    connection: &mut SqliteConnection,
    kind: Kind,
    run: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query(BEGIN_PERIOD).bind(kind.number()).bind(run).execute(connection).await?;
    Ok(())
}

/// A row of the table `arrival`. The row is identified by its kind, owner and `from_s`.
#[derive(Clone, Copy, Debug)]
struct Arrival {
    kind: Kind,
    owner: i64,
    /// Second of the storage clock at which the data began to arrive; 0 in a row for all earlier data.
    from_s: i64,
    extent: Extent,
}

/// Returns whether any data of this kind arrived at the second `until_s` of the storage clock or before.
pub(super) async fn has_due(
    connection: &mut SqliteConnection,
    kind: Kind,
    until_s: i64,
) -> Result<bool, sqlx::Error> {
    Ok(next_due(connection, kind, until_s).await?.is_some())
}

/// Returns the arrival of this kind whose retention period began first, if it began at the second `until_s` or before.
async fn next_due(
    connection: &mut SqliteConnection,
    kind: Kind,
    until_s: i64,
) -> Result<Option<Arrival>, sqlx::Error> {
    let row: Option<(i64, i64, i64, i64)> =
        sqlx::query_as(NEXT).bind(kind.number()).bind(until_s).fetch_optional(connection).await?;
    Ok(row.map(|(owner, from_s, first, last)| Arrival {
        kind,
        owner,
        from_s,
        extent: Extent { first, last },
    }))
}

/// Result of deleting due data.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrimResult {
    /// Cost of the deleted rows, in rows of the table `node`.
    pub(super) cost: u64,
    /// `true` if no due data remains.
    pub(super) is_complete: bool,
}

/// Deletes data that arrived at the second `until_s` of the storage clock or before, in the order of arrival. Stops at
/// a cost of about `max_cost`.
pub(super) async fn trim(
    connection: &mut SqliteConnection,
    (kind, cause): (Kind, Cause),
    until_s: i64,
    now_s: i64,
    max_cost: u64,
    deletions: &mut Vec<Deletion>,
) -> Result<TrimResult, sqlx::Error> {
    let mut cost = 0;
    // The number of rows is limited, too, because an arrival whose data is deleted already adds nothing to the cost.
    for _ in 0..MAX_ROWS {
        let remaining_cost = max_cost.saturating_sub(cost);
        if remaining_cost == 0 {
            break;
        }
        let Some(arrival) = next_due(connection, kind, until_s).await? else {
            return Ok(TrimResult { cost, is_complete: true });
        };
        let deleted = arrival.delete(connection, now_s, remaining_cost).await?;
        cost += deleted.cost;
        if deleted.items > 0 {
            deletions.push(Deletion { cause, kind, owner: arrival.owner, items: deleted.items });
        }
    }
    Ok(TrimResult { cost, is_complete: false })
}

impl Arrival {
    /// Deletes data that only this arrival covers, at a cost of about `max_cost`. When all such data is deleted, the
    /// arrival is removed from the table. If clock samples remain because of a pinned run, the arrival is kept, and its
    /// retention period begins again.
    async fn delete(
        self,
        connection: &mut SqliteConnection,
        now_s: i64,
        max_cost: u64,
    ) -> Result<DeletedRows, sqlx::Error> {
        let mut kept_extents = self.later_extents(connection).await?;
        let pinned = match self.kind {
            Kind::ClockSamples => clocks::pinned_times(connection, self.owner).await?,
            _ => Vec::new(),
        };
        kept_extents.extend(&pinned);
        let mut deleted = DeletedRows::default();
        for part in self.extent.without(kept_extents) {
            loop {
                let remaining_cost = max_cost.saturating_sub(deleted.cost);
                if remaining_cost == 0 {
                    return Ok(deleted);
                }
                let deleted_now = match self.kind {
                    Kind::Nodes => nodes::delete(connection, self.owner, part, remaining_cost).await?,
                    Kind::Buckets(width_s) => {
                        buckets::delete(connection, self.owner, width_s, part, remaining_cost).await?
                    }
                    Kind::ClockSamples => {
                        clocks::delete(connection, self.owner, part, remaining_cost).await?
                    }
                };
                deleted.cost += deleted_now.cost;
                deleted.items += deleted_now.items;
                if deleted_now.is_complete {
                    break;
                }
            }
        }
        let mut has_pinned_data = false;
        for Extent { first, last } in pinned {
            let part = Extent { first: first.max(self.extent.first), last: last.min(self.extent.last) };
            has_pinned_data = has_pinned_data
                || (part.first <= part.last && clocks::has_samples(connection, self.owner, part).await?);
        }
        // The rest is due again only after a whole period. Otherwise each step would examine this arrival again while
        // the run is pinned.
        let statement = if has_pinned_data { POSTPONE } else { REMOVE };
        let statement = sqlx::query(statement).bind(self.kind.number()).bind(self.owner).bind(self.from_s);
        if has_pinned_data { statement.bind(now_s) } else { statement }.execute(connection).await?;
        Ok(DeletedRows { is_complete: true, ..deleted })
    }

    /// Returns the ranges of the owner's data that arrived after this arrival and may overlap it.
    async fn later_extents(self, connection: &mut SqliteConnection) -> Result<Vec<Extent>, sqlx::Error> {
        let rows: Vec<(i64, i64)> = sqlx::query_as(LATER)
            .bind(self.kind.number())
            .bind(self.owner)
            .bind(self.from_s)
            .bind(self.extent.first)
            .bind(self.extent.last)
            .fetch_all(&mut *connection)
            .await?;
        let mut later: Vec<Extent> = rows.into_iter().map(|(first, last)| Extent { first, last }).collect();
        let arriving = match self.kind {
            Kind::ClockSamples => {
                let row = sqlx::query_as(ARRIVING_LINK).bind(self.owner).fetch_optional(connection).await?;
                row.map(|(first, last): (i64, i64)| Extent { first, last })
            }
            kind => {
                let row = sqlx::query_as(ARRIVING_RUN).bind(self.owner).fetch_optional(connection).await?;
                row.map(|(first, last, first_s, last_s): (i64, i64, i64, i64)| match kind {
                    Kind::Buckets(width_s) => {
                        Extent { first: bucket(first_s, width_s), last: bucket(last_s, width_s) }
                    }
                    _ => Extent { first, last },
                })
            }
        };
        later.extend(arriving);
        Ok(later)
    }
}
