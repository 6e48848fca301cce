//! The table `arrival`: it records when each range of data arrived, and so which data has to be deleted next.
//!
//! If a later row of the same owner covers a part of the range, that part is kept until the later row is due. A jump of
//! a robot's clock during a run therefore leads to no early deletion.

use sqlx::SqliteConnection;

use super::deletions::{Cause, Deletion};
use super::{DeletedRows, Kind, buckets, clocks, nodes};
use crate::extent::Extent;
use crate::rollups::bucket;

/// Maximum number of rows of the table per transaction.
const MAX_ROWS: usize = 64;

/// Sets whether a run is pinned; triggers then update the table `arrival`: ?1 run, ?2 0 or 1.
const PIN: &str = "UPDATE run SET pinned = ?2 WHERE number = ?1";
/// Inserts a row that covers all data of a kind, whose retention period begins now: ?1 kind, ?2 run.
const RELEASE: &str = "INSERT INTO arrival (kind, owner, from_s, to_s, first, last) \
     SELECT ?1, number, 0, coalesce((SELECT elapsed_ns / 1000000000 FROM storage_clock), 0), \
       -9223372036854775808, 9223372036854775807 FROM run WHERE number = ?2 AND pinned = 0 \
     ON CONFLICT (kind, owner, from_s) DO UPDATE SET to_s = excluded.to_s, first = excluded.first, last = excluded.last";
/// The row whose retention period began first, at second ?2 of the storage clock or before: ?1 kind.
const NEXT: &str =
    "SELECT owner, from_s, first, last FROM arrival WHERE kind = ?1 AND to_s <= ?2 ORDER BY to_s LIMIT 1";
/// Later rows that overlap a row: ?1 kind, ?2 owner, ?3 `from_s` of the row, ?4 and ?5 its first and last value.
const LATER: &str = "SELECT first, last FROM arrival WHERE kind = ?1 AND owner = ?2 AND from_s > ?3 \
     AND first <= ?5 AND last >= ?4";
/// Ranges of a run's data whose arrival is not in the table yet: ?1 run.
const ARRIVING_RUN: &str = "SELECT arriving_first_number, arriving_last_number, arriving_first_s, arriving_last_s \
     FROM run WHERE number = ?1 AND arriving_from_s IS NOT NULL";
/// Range of a link's data whose arrival is not in the table yet: ?1 link.
const ARRIVING_LINK: &str =
    "SELECT arriving_first_ns, arriving_last_ns FROM link WHERE id = ?1 AND arriving_from_s IS NOT NULL";
/// Removes a row: ?1 kind, ?2 owner, ?3 `from_s`.
const REMOVE: &str = "DELETE FROM arrival WHERE kind = ?1 AND owner = ?2 AND from_s = ?3";
/// Begins the retention period of a row again: ?1 kind, ?2 owner, ?3 `from_s`, ?4 now.
const POSTPONE: &str = "UPDATE arrival SET to_s = ?4 WHERE kind = ?1 AND owner = ?2 AND from_s = ?3";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 8] = [
    ("PIN", PIN),
    ("RELEASE", RELEASE),
    ("NEXT", NEXT),
    ("LATER", LATER),
    ("ARRIVING_RUN", ARRIVING_RUN),
    ("ARRIVING_LINK", ARRIVING_LINK),
    ("REMOVE", REMOVE),
    ("POSTPONE", POSTPONE),
];

/// Pins a run, so that none of its data is deleted, or releases it, so that its retention periods begin now. Returns
/// whether the run exists. Data that was deleted before stays deleted.
pub(crate) async fn pin(
    connection: &mut SqliteConnection,
    run: i64,
    pinned: bool,
) -> Result<bool, sqlx::Error> {
    let result = sqlx::query(PIN).bind(run).bind(pinned).execute(connection).await?;
    Ok(result.rows_affected() > 0)
}

/// Begins the retention period of all stored data of one kind of a run, unless the run is pinned.
pub(crate) async fn release(
    connection: &mut SqliteConnection,
    kind: Kind,
    run: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query(RELEASE).bind(kind.number()).bind(run).execute(connection).await?;
    Ok(())
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
struct Arrival {
    kind: Kind,
    owner: i64,
    from_s: i64,
    extent: Extent,
}

/// Returns whether there is data of this kind that had arrived by `before_s`, a second of the storage clock.
pub(super) async fn has_due(
    connection: &mut SqliteConnection,
    kind: Kind,
    before_s: i64,
) -> Result<bool, sqlx::Error> {
    Ok(next(connection, kind, before_s).await?.is_some())
}

async fn next(
    connection: &mut SqliteConnection,
    kind: Kind,
    before_s: i64,
) -> Result<Option<Arrival>, sqlx::Error> {
    let row: Option<(i64, i64, i64, i64)> =
        sqlx::query_as(NEXT).bind(kind.number()).bind(before_s).fetch_optional(connection).await?;
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
    /// `true` if no other data is due.
    pub(super) is_complete: bool,
}

/// Deletes data that had arrived by `before_s`, a second of the storage clock, in the order of arrival. Stops at a cost
/// of about `max_cost`.
pub(super) async fn trim(
    connection: &mut SqliteConnection,
    (kind, cause): (Kind, Cause),
    before_s: i64,
    now_s: i64,
    max_cost: u64,
    deletions: &mut Vec<Deletion>,
) -> Result<TrimResult, sqlx::Error> {
    let mut cost = 0;
    // The number of rows is limited as well, because an arrival whose data is gone costs nothing.
    for _ in 0..MAX_ROWS {
        let remaining_cost = max_cost.saturating_sub(cost);
        if remaining_cost == 0 {
            break;
        }
        let Some(arrival) = next(connection, kind, before_s).await? else {
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
    /// arrival is removed. If pinned data remains, the arrival is kept, and its period begins again.
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
        let statement = if has_pinned_data { POSTPONE } else { REMOVE };
        let statement = sqlx::query(statement).bind(self.kind.number()).bind(self.owner).bind(self.from_s);
        if has_pinned_data { statement.bind(now_s) } else { statement }.execute(connection).await?;
        Ok(DeletedRows { is_complete: true, ..deleted })
    }

    /// Returns the extents of data of the same owner that arrived later and overlaps this arrival.
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
