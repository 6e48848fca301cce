//! Which run is next, and what is remembered of it.

use peernet_clock::WallTime;
use sqlx::SqliteConnection;

use super::{Kind, RUNS, buckets, nodes, slack_s};
use crate::store::column::column;

/// Pins a run, so that nothing of it is deleted, or lets it go: its periods count from now then. False when there is no
/// such run. What was deleted before stays deleted.
pub(crate) async fn pin(
    connection: &mut SqliteConnection,
    run: i64,
    pinned: bool,
) -> Result<bool, sqlx::Error> {
    let done = sqlx::query(PIN).bind(run).bind(pinned).execute(connection).await?;
    Ok(done.rows_affected() > 0)
}

/// Something of this kind has to go in its time, counted from now, unless the run is pinned.
pub(crate) async fn release(
    connection: &mut SqliteConnection,
    kind: Kind,
    run: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query(RELEASE).bind(kind.number()).bind(run).execute(connection).await?;
    Ok(())
}

/// Triggers see to the table `retained`: ?1 run, ?2 0 or 1.
const PIN: &str = "UPDATE run SET pinned = ?2 WHERE number = ?1";
/// ?1 kind, ?2 run.
const RELEASE: &str =
    "INSERT OR IGNORE INTO retained (kind, run) SELECT ?1, number FROM run WHERE number = ?2 AND pinned = 0";
const ARRIVED: &str =
    "SELECT EXISTS (SELECT 1 FROM retained WHERE kind IN (0, 1, 10, 60, 3600) AND look_s IS NULL)";
/// ?1 kind, ?2 now, ?3 limit.
const ARRIVE: &str = "UPDATE retained SET look_s = ?2 WHERE kind = ?1 AND run IN \
     (SELECT run FROM retained WHERE kind = ?1 AND look_s IS NULL LIMIT ?3)";
/// The two runs whose periods began first: ?1 kind, ?2 only before this second.
const NEXT: &str = "SELECT run, look_s FROM retained WHERE kind = ?1 AND look_s < ?2 ORDER BY look_s LIMIT 2";
/// ?1 kind, ?2 run, ?3 second.
const LATER: &str = "UPDATE retained SET look_s = ?3 WHERE kind = ?1 AND run = ?2";
/// ?1 kind, ?2 run.
const SETTLE: &str = "DELETE FROM retained WHERE kind = ?1 AND run = ?2";
/// ?1 run.
const SETTLED: &str = "UPDATE run SET settled = 1 WHERE number = ?1";
/// ?1 run.
const ENDED: &str = "SELECT ended_ns IS NOT NULL FROM run WHERE number = ?1";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 9] = [
    ("PIN", PIN),
    ("RELEASE", RELEASE),
    ("ARRIVED", ARRIVED),
    ("ARRIVE", ARRIVE),
    ("NEXT", NEXT),
    ("LATER", LATER),
    ("SETTLE", SETTLE),
    ("SETTLED", SETTLED),
    ("ENDED", ENDED),
];

/// Whether there are runs that were not seen before.
pub(super) async fn arrived(connection: &mut SqliteConnection) -> Result<bool, sqlx::Error> {
    sqlx::query_scalar(ARRIVED).fetch_one(connection).await
}

/// Their periods count from now: a robot whose clock is behind, or that delivers what it measured weeks ago, is
/// not deleted as it comes.
pub(super) async fn arrive(
    connection: &mut SqliteConnection,
    now_s: i64,
    rows: u64,
) -> Result<(), sqlx::Error> {
    let runs = column(rows / Kind::ALL.len() as u64).max(1);
    for kind in Kind::ALL {
        let some = sqlx::query(ARRIVE).bind(kind.number()).bind(now_s).bind(runs);
        some.execute(&mut *connection).await?;
    }
    Ok(())
}

/// Whether there is a run of which something of this kind is due.
pub(super) async fn due(
    connection: &mut SqliteConnection,
    kind: Kind,
    before_s: i64,
) -> Result<bool, sqlx::Error> {
    Ok(!next(connection, kind, before_s).await?.is_empty())
}

/// The run that is next, with the second from which its period counts, and the one after it.
async fn next(
    connection: &mut SqliteConnection,
    kind: Kind,
    before_s: i64,
) -> Result<Vec<(i64, i64)>, sqlx::Error> {
    sqlx::query_as(NEXT).bind(kind.number()).bind(before_s).fetch_all(connection).await
}

/// How much may go.
#[derive(Clone, Copy, Debug)]
pub(super) enum Reach {
    /// Of runs whose period counts from before one second, what began before another one.
    Aged { due_s: i64, end_s: i64 },
    /// The oldest of all runs, however young.
    Oldest,
}

impl Reach {
    /// What has to begin before this second for its run to be looked at.
    const fn due_s(self, now_s: i64) -> i64 {
        match self {
            Self::Aged { due_s, .. } => due_s,
            // Runs of which nothing is left are looked at again from the next second on.
            Self::Oldest => now_s + 1,
        }
    }

    /// What begins before this second may go of the first of these runs.
    ///
    /// Where the oldest goes, the run gets ahead of the next one by a little only. What seems to begin later than now
    /// has no age to compare, and goes when all others have come this far.
    fn end_s(self, runs: &[(i64, i64)], now_s: i64) -> i64 {
        match (self, runs) {
            (Self::Aged { end_s, .. }, _) => end_s,
            (Self::Oldest, [(_, first_s), (_, next_s), ..]) => {
                let end_s = next_s + slack_s(now_s - first_s);
                if end_s > now_s { i64::MAX } else { end_s }
            }
            (Self::Oldest, _) => i64::MAX,
        }
    }
}

/// What was done with the runs that are due.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trimmed {
    /// Deleted, in the cost of a small row.
    pub(super) rows: u64,
    /// No run is due any more.
    pub(super) through: bool,
}

/// Deletes of one run after the other what may go, beginning with the one whose period counts from first.
pub(super) async fn trim(
    connection: &mut SqliteConnection,
    kind: Kind,
    reach: Reach,
    now: WallTime,
    rows: u64,
) -> Result<Trimmed, sqlx::Error> {
    let now_s = now.unix_seconds();
    let due_s = reach.due_s(now_s);
    let mut deleted = 0;
    for _ in 0..RUNS {
        let left = rows.saturating_sub(deleted);
        if left == 0 {
            break;
        }
        let runs = next(connection, kind, due_s).await?;
        let Some(&(run, _)) = runs.first() else {
            return Ok(Trimmed { rows: deleted, through: true });
        };
        let end_s = reach.end_s(&runs, now_s);
        let gone = match kind {
            Kind::Nodes => nodes::delete(connection, run, end_s, left).await?,
            Kind::Buckets(width_s) => buckets::delete(connection, run, width_s, end_s, left).await?,
        };
        deleted += gone.rows;
        match gone.left_s {
            // It stays due: there is more to delete.
            Some(left_s) if left_s < end_s => later(connection, kind, run, left_s.min(due_s - 1)).await?,
            Some(left_s) => later(connection, kind, run, left_s.min(now_s)).await?,
            None => emptied(connection, kind, run, now_s).await?,
        }
    }
    Ok(Trimmed { rows: deleted, through: false })
}

/// Its period counts from this second.
async fn later(
    connection: &mut SqliteConnection,
    kind: Kind,
    run: i64,
    look_s: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query(LATER).bind(kind.number()).bind(run).bind(look_s).execute(connection).await?;
    Ok(())
}

/// Nothing of this kind is left: more may come of a run that goes on, and of another one only by exception.
async fn emptied(
    connection: &mut SqliteConnection,
    kind: Kind,
    run: i64,
    now_s: i64,
) -> Result<(), sqlx::Error> {
    let ended: Option<bool> = sqlx::query_scalar(ENDED).bind(run).fetch_optional(&mut *connection).await?;
    if ended == Some(false) {
        return later(connection, kind, run, now_s + 1).await;
    }
    sqlx::query(SETTLE).bind(kind.number()).bind(run).execute(&mut *connection).await?;
    sqlx::query(SETTLED).bind(run).execute(connection).await?;
    Ok(())
}
