//! The rows that are written one by one: incidents, gaps, marks, counters, the quarantine.

use bytes::Bytes;
use peernet_clock::WallTime;
use peernet_logger::RunId;
use peernet_logger::stream::codec::{self, BatchHead};
use peernet_logger::stream::{Batch, Gap, Incident, Missing, ToAggregator};

use sqlx::SqliteConnection;

use super::ends::LEFT;
use super::entities::Entities;
use super::iteration::RunCounts;
use super::{Refusal, Work};
use crate::picture::Stored;

/// Quarantined batches that are kept.
const QUARANTINE_KEEPS: i64 = 1_000;

/// Something happened beside the measurements.
pub(super) async fn incident(
    connection: &mut SqliteConnection,
    entities: &mut Entities,
    host: i64,
    incident: &Incident,
    now: WallTime,
) -> Result<(), Refusal> {
    let run = known_number(connection, entities, incident.run).await?;
    let peer = match incident.peer {
        Some(peer) => Some(entities.host(connection, peer, now).await?),
        None => None,
    };
    sqlx::query(
        "INSERT INTO incident (host, at_ns, kind, pipeline, run, peer, text) VALUES (?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(host)
    .bind(incident.at.unix_nanos())
    .bind(incident.kind.name())
    .bind(incident.pipeline.as_ref().map(ToString::to_string))
    .bind(run)
    .bind(peer)
    .bind(incident.text.as_str())
    .execute(connection)
    .await?;
    Ok(())
}

/// The agent dropped events.
pub(super) async fn gap(
    connection: &mut SqliteConnection,
    entities: &mut Entities,
    host: i64,
    gap: &Gap,
) -> Result<(), Refusal> {
    let run = known_number(connection, entities, gap.run).await?;
    sqlx::query(
        "INSERT INTO gap (host, pipeline, run, from_ns, to_ns, count, reason) VALUES (?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(host)
    .bind(gap.pipeline.as_ref().map(ToString::to_string))
    .bind(run)
    .bind(gap.from.unix_nanos())
    .bind(gap.to.unix_nanos())
    .bind(i64::try_from(gap.count).unwrap_or(i64::MAX))
    .bind(gap.reason.as_str())
    .execute(connection)
    .await?;
    Ok(())
}

async fn known_number(
    connection: &mut SqliteConnection,
    entities: &mut Entities,
    run: Option<RunId>,
) -> Result<Option<i64>, Refusal> {
    match run {
        Some(run) => Ok(entities.known_run(connection, run).await?.map(|run| run.number)),
        None => Ok(None),
    }
}

/// Adds to the counters of runs.
pub(super) async fn count_runs(
    connection: &mut SqliteConnection,
    runs: impl Iterator<Item = (i64, RunCounts)>,
) -> Result<(), Refusal> {
    for (run, counts) in runs {
        sqlx::query(
            "UPDATE run SET warm_up = warm_up + ?1, ok = ok + ?2, failed = failed + ?3, lost = lost + ?4, \
             timeout = timeout + ?5, last_iteration_ns = max(coalesce(last_iteration_ns, ?6), ?6), \
             ended_ns = iif(end_reason = ?8, max(ended_ns, ?6), ended_ns) WHERE number = ?7",
        )
        .bind(counts.warm_up as i64)
        .bind(counts.outcomes.ok as i64)
        .bind(counts.outcomes.failed as i64)
        .bind(counts.outcomes.lost as i64)
        .bind(counts.outcomes.timeout as i64)
        .bind(counts.last.unix_nanos())
        .bind(run)
        .bind(LEFT)
        .execute(&mut *connection)
        .await?;
    }
    Ok(())
}

/// All batches up to this one are stored.
pub(super) async fn mark(
    connection: &mut SqliteConnection,
    host: i64,
    head: BatchHead,
    now: WallTime,
) -> Result<(), Refusal> {
    sqlx::query(
        "INSERT INTO stream (uuid, host, stored, first_seen_ns, last_seen_ns) VALUES (?1, ?2, ?3, ?4, ?4) \
         ON CONFLICT (uuid) DO UPDATE SET stored = excluded.stored, last_seen_ns = excluded.last_seen_ns",
    )
    .bind(head.stream.to_string())
    .bind(host)
    .bind(number(head.number))
    .bind(now.unix_nanos())
    .execute(connection)
    .await?;
    Ok(())
}

/// Batches of a stream will never come.
pub(super) async fn missing(
    connection: &mut SqliteConnection,
    host: i64,
    missing: &Missing,
    now: WallTime,
) -> Result<(), Refusal> {
    let Missing { stream, from, through, .. } = missing;
    let reason =
        format!("batches {from} to {through} of stream {stream} never came: the agent no longer holds them");
    sqlx::query("INSERT INTO gap (host, from_ns, to_ns, count, reason) VALUES (?1, ?2, ?2, 0, ?3)")
        .bind(host)
        .bind(now.unix_nanos())
        .bind(reason)
        .execute(connection)
        .await?;
    Ok(())
}

/// Puts a batch aside that cannot be stored.
pub(super) async fn quarantine(
    connection: &mut SqliteConnection,
    host: i64,
    head: BatchHead,
    work: &Work,
    reason: &str,
    now: WallTime,
) -> Result<(), Refusal> {
    let (events, frame) = match work {
        Work::Batch(batch) => {
            let message = ToAggregator::Batch(Batch::clone(batch));
            (Some(batch.events.len() as i64), Bytes::from(codec::encode(&message)))
        }
        Work::Unreadable { frame, .. } => (None, frame.clone()),
        Work::Hello { .. } | Work::Goodbye(_) | Work::Name(_) | Work::Missing(_) => (None, Bytes::new()),
    };
    sqlx::query(
        "INSERT INTO quarantine (host, stream, number, received_ns, events, reason, frame) VALUES (?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(host)
    .bind(head.stream.to_string())
    .bind(number(head.number))
    .bind(now.unix_nanos())
    .bind(events)
    .bind(reason)
    .bind(frame.as_ref())
    .execute(&mut *connection)
    .await?;
    sqlx::query("DELETE FROM quarantine WHERE id <= (SELECT max(id) FROM quarantine) - ?")
        .bind(QUARANTINE_KEEPS)
        .execute(connection)
        .await?;
    Ok(())
}

/// Numbers of batches stay far below; greetings that claim others are refused.
fn number(of_batch: u64) -> i64 {
    i64::try_from(of_batch).unwrap_or(i64::MAX)
}

/// Adds to the counters of a host and returns what they are now.
pub(super) async fn count_host(
    connection: &mut SqliteConnection,
    host: i64,
    added: &Stored,
    now: WallTime,
) -> Result<Stored, Refusal> {
    let (events, nodes, gaps, missing, quarantined): (i64, i64, i64, i64, i64) = sqlx::query_as(
        "UPDATE host SET last_seen_ns = ?, events = events + ?, nodes = nodes + ?, gaps = gaps + ?, \
         missing = missing + ?, quarantined = quarantined + ? WHERE id = ? \
         RETURNING events, nodes, gaps, missing, quarantined",
    )
    .bind(now.unix_nanos())
    .bind(added.events as i64)
    .bind(added.nodes as i64)
    .bind(added.gaps as i64)
    .bind(i64::try_from(added.missing).unwrap_or(i64::MAX))
    .bind(added.quarantined as i64)
    .bind(host)
    .fetch_one(connection)
    .await?;
    let [events, nodes, gaps, missing, quarantined] =
        [events, nodes, gaps, missing, quarantined].map(|count| u64::try_from(count).unwrap_or(0));
    Ok(Stored { events, nodes, gaps, missing, duplicates: 0, quarantined })
}
