//! Samples of the relations between hosts' clocks: link by link, some links at a time. There are few links, so they are
//! simply gone through; when the period of each counts from stands in its row, as for runs. Samples from the time of a
//! pinned run of the link's edge stay, so that its delays can be judged again.

use peernet_clock::{Span, WallTime};
use sqlx::SqliteConnection;

use super::due_s;
use crate::store::column::column;

/// All links are looked through once in so long.
const ROUND: Span = Span::from_seconds(600);
/// Links that are read together.
const LINKS: i64 = 64;
/// Samples stay so long before and after a pinned run.
const AROUND_NS: i64 = 3_600_000_000_000;
/// What a row costs, in nodes: it is some times as long.
const ROW: u64 = 5;

/// ?1 the link before, ?2 limit.
const LINK: &str = "SELECT id, edge, look_s FROM link WHERE id > ?1 ORDER BY id LIMIT ?2";
/// ?1 link, ?2 second.
const LATER: &str = "UPDATE link SET look_s = ?2 WHERE id = ?1";
/// The oldest sample: ?1 link, ?2 from, ?3 end.
const OLDEST: &str = "SELECT min(at_ns) FROM clock_sample WHERE link = ?1 AND at_ns >= ?2 AND at_ns < ?3";
/// Pinned runs of an edge: ?1 host.
const PINNED: &str = "SELECT run.started_ns, coalesce(max(run.ended_ns, run.last_iteration_ns), run.ended_ns, 9223372036854775807) \
     FROM run INDEXED BY run_pinned CROSS JOIN pipeline ON pipeline.id = run.pipeline \
     WHERE run.pinned = 1 AND pipeline.host = ?1 ORDER BY run.started_ns";
/// The sample after so many: ?1 link, ?2 from, ?3 end, ?4 rows.
const AFTER: &str = "SELECT at_ns FROM clock_sample WHERE link = ?1 AND at_ns >= ?2 AND at_ns < ?3 \
     ORDER BY at_ns LIMIT 1 OFFSET ?4";
/// ?1 link, ?2 from, ?3 end.
const DELETE: &str = "DELETE FROM clock_sample WHERE link = ?1 AND at_ns >= ?2 AND at_ns < ?3";
/// Windows of which no sample is left; the last one may go on: ?1 link, ?2 end.
const WINDOWS: &str = "DELETE FROM clock_window WHERE link = ?1 AND last_ns < ?2 \
     AND id <> (SELECT max(id) FROM clock_window WHERE link = ?1) \
     AND NOT EXISTS (SELECT 1 FROM clock_sample WHERE clock_sample.link = clock_window.link \
       AND clock_sample.at_ns BETWEEN clock_window.first_ns AND clock_window.last_ns \
       AND clock_sample.window = clock_window.window)";

#[cfg(test)]
pub(super) const STATEMENTS: [(&str, &str); 7] = [
    ("LINK", LINK),
    ("LINK_LATER", LATER),
    ("CLOCK_OLDEST", OLDEST),
    ("PINNED", PINNED),
    ("CLOCK_AFTER", AFTER),
    ("CLOCK_DELETE", DELETE),
    ("WINDOWS", WINDOWS),
];

/// What is to be done with a link.
#[derive(Clone, Copy, Debug)]
pub(super) enum Due {
    /// Samples from one moment up to another may go.
    Delete { link: i64, from_ns: i64, end_ns: i64 },
    /// Its period counts from this second.
    Later { link: i64, look_s: i64 },
}

/// Looks through the links.
#[derive(Debug)]
pub(super) struct ClockSamples {
    kept_s: Option<i64>,
    /// The link looked at last.
    link: i64,
    /// When the last round ended.
    rested: Option<WallTime>,
}

impl ClockSamples {
    pub(super) const fn new(kept_s: Option<i64>) -> Self {
        Self { kept_s, link: i64::MIN, rested: None }
    }

    /// What is to be done next.
    pub(super) async fn next(
        &mut self,
        connection: &mut SqliteConnection,
        now: WallTime,
    ) -> Result<Option<Due>, sqlx::Error> {
        let Some(kept_s) = self.kept_s else { return Ok(None) };
        if self.rested.is_some_and(|rested| now >= rested && now < rested + ROUND) {
            return Ok(None);
        }
        let now_s = now.unix_seconds();
        let before_ns = (now - Span::from_seconds(kept_s)).unix_nanos();
        loop {
            let links: Vec<(i64, i64, Option<i64>)> =
                sqlx::query_as(LINK).bind(self.link).bind(LINKS).fetch_all(&mut *connection).await?;
            for (link, edge, look_s) in &links {
                self.link = *link;
                let due = look_s.is_none_or(|look_s| look_s < due_s(now, kept_s));
                if !due {
                    continue;
                }
                if look_s.is_none() {
                    return Ok(Some(Due::Later { link: *link, look_s: now_s }));
                }
                if let Some(due) = stretch(connection, (*link, *edge), before_ns).await? {
                    // There may be more of it.
                    self.link = link - 1;
                    return Ok(Some(due));
                }
                let oldest: Option<i64> = sqlx::query_scalar(OLDEST)
                    .bind(link)
                    .bind(before_ns)
                    .bind(i64::MAX)
                    .fetch_one(&mut *connection)
                    .await?;
                let oldest_s = oldest.map_or(now_s, |oldest| oldest.div_euclid(1_000_000_000));
                return Ok(Some(Due::Later { link: *link, look_s: oldest_s.min(now_s) }));
            }
            if links.is_empty() {
                (self.link, self.rested) = (i64::MIN, Some(now));
                return Ok(None);
            }
        }
    }

    /// Does it; of samples, about so many rows go.
    pub(super) async fn perform(
        connection: &mut SqliteConnection,
        due: Due,
        rows: u64,
    ) -> Result<(), sqlx::Error> {
        let (link, from_ns, end_ns) = match due {
            Due::Delete { link, from_ns, end_ns } => (link, from_ns, end_ns),
            Due::Later { link, look_s } => {
                sqlx::query(LATER).bind(link).bind(look_s).execute(connection).await?;
                return Ok(());
            }
        };
        let after: Option<i64> = sqlx::query_scalar(AFTER)
            .bind(link)
            .bind(from_ns)
            .bind(end_ns)
            .bind(column((rows / ROW).max(1)))
            .fetch_optional(&mut *connection)
            .await?;
        let through_ns = after.map_or(end_ns, |after| after.max(from_ns.saturating_add(1)));
        sqlx::query(DELETE).bind(link).bind(from_ns).bind(through_ns).execute(&mut *connection).await?;
        sqlx::query(WINDOWS).bind(link).bind(through_ns).execute(connection).await?;
        Ok(())
    }
}

/// The oldest samples of a link that may go.
async fn stretch(
    connection: &mut SqliteConnection,
    (link, edge): (i64, i64),
    before_ns: i64,
) -> Result<Option<Due>, sqlx::Error> {
    let mut pinned: Option<Vec<(i64, i64)>> = None;
    let mut from_ns = i64::MIN;
    loop {
        let oldest: Option<i64> = sqlx::query_scalar(OLDEST)
            .bind(link)
            .bind(from_ns)
            .bind(before_ns)
            .fetch_one(&mut *connection)
            .await?;
        let Some(oldest) = oldest else { return Ok(None) };
        let pinned = match &mut pinned {
            Some(known) => known,
            unknown => unknown.insert(sqlx::query_as(PINNED).bind(edge).fetch_all(&mut *connection).await?),
        };
        let reach =
            |(begin, end): &(i64, i64)| (begin.saturating_sub(AROUND_NS), end.saturating_add(AROUND_NS));
        match pinned.iter().map(reach).find(|(begin, end)| (*begin..*end).contains(&oldest)) {
            Some((_, end)) => from_ns = end,
            None => {
                let begins = pinned.iter().map(|run| reach(run).0).filter(|begin| *begin > oldest).min();
                let end_ns = begins.map_or(before_ns, |begin| begin.min(before_ns));
                return Ok(Some(Due::Delete { link, from_ns: oldest, end_ns }));
            }
        }
    }
}
