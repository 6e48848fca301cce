//! Rows that are written one by one: incidents, gaps, quarantined batches.

use bytes::Bytes;
use peernet_clock::WallTime;
use peernet_logger::RunId;
use peernet_statistics::number::counted;
use peernet_stream::{BatchHead, Gap, Incident, IncidentKind, MissingBatches, StreamId};
use sqlx::SqliteConnection;

use super::Refusal;
use super::entities::{Entities, Reporter};
use super::prepared::MAX_MISSING_EVENTS;
use crate::column::column;
use crate::stored::{StoredCounts, other_database_prefix};

/// Maximum number of quarantined batches. Older batches are deleted.
// Without a maximum, an agent whose batches are always invalid would fill the disk.
const MAX_QUARANTINED: i64 = 1_000;

/// Stores an incident of a host.
pub(super) async fn insert_incident(
    connection: &mut SqliteConnection,
    entities: &mut Entities,
    reporter: Reporter,
    incident: &Incident,
    now: WallTime,
) -> Result<(), Refusal> {
    let run = run_number(connection, entities, reporter, incident.run).await?;
    let peer = match incident.peer {
        Some(peer) => Some(entities.host(connection, peer, now).await?),
        None => None,
    };
    sqlx::query(
        "INSERT INTO incident (host, at_ns, kind, pipeline, run, peer, text) VALUES (?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(reporter.row)
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

/// Stores a gap that an agent reported, or a gap for the events of a quarantined batch.
pub(super) async fn insert_gap(
    connection: &mut SqliteConnection,
    entities: &mut Entities,
    reporter: Reporter,
    gap: &Gap,
) -> Result<(), Refusal> {
    let run = run_number(connection, entities, reporter, gap.run).await?;
    sqlx::query(
        "INSERT INTO gap (host, pipeline, run, from_ns, to_ns, count, reason) VALUES (?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(reporter.row)
    .bind(gap.pipeline.as_ref().map(ToString::to_string))
    .bind(run)
    .bind(gap.from.unix_nanos())
    .bind(gap.to.unix_nanos())
    .bind(column(gap.count))
    .bind(gap.reason.as_str())
    .execute(connection)
    .await?;
    Ok(())
}

/// Returns the number of the reporter's run with this id, if the run is stored.
async fn run_number(
    connection: &mut SqliteConnection,
    entities: &mut Entities,
    reporter: Reporter,
    run: Option<RunId>,
) -> Result<Option<i64>, Refusal> {
    match run {
        Some(run) => Ok(entities.find_run(connection, reporter, run).await?.map(|run| run.number)),
        None => Ok(None),
    }
}

/// Stores a gap for batches of a stream that will never arrive. `is_first_contact` is `true` if the database has not
/// stored anything from the host before.
pub(super) async fn insert_missing_batches(
    connection: &mut SqliteConnection,
    host: i64,
    missing: &MissingBatches,
    is_first_contact: bool,
    now: WallTime,
) -> Result<StoredCounts, Refusal> {
    let MissingBatches { stream, from, through, events, .. } = missing;
    let reason = match is_first_contact {
        true => describe_batches_of_other_database(stream, *from, *through),
        false => format!(
            "batches {from} to {through} of stream {stream} are not in this database: they were stored in another database before this one was \
             created or restored, and their agent has deleted them from its spool"
        ),
    };
    insert_unattributed_gap(connection, host, &reason, *events, now).await
}

/// Returns the reason of a gap for batches that their host sent to another database before. The SQL expression
/// `gap_columns!` recognises such a gap by the prefix of the reason.
pub(super) fn describe_batches_of_other_database(stream: &StreamId, from: u64, through: u64) -> String {
    format!(
        "{}batches {from} to {through} of stream {stream} were stored in another database, and their agent has deleted them from its spool",
        other_database_prefix!()
    )
}

/// Stores a gap of `events` events whose runs are unknown. No page of a run shows this gap, so an incident with the
/// reason is stored, too. If the number of events is unknown (`None`), the gap has the number 0. Returns the additions
/// to the counters of the host.
pub(super) async fn insert_unattributed_gap(
    connection: &mut SqliteConnection,
    host: i64,
    reason: &str,
    events: Option<u64>,
    now: WallTime,
) -> Result<StoredCounts, Refusal> {
    // Batches without events leave no gap. If the agent's spool has lost events of these batches, the agent itself
    // reports a gap for them.
    if events == Some(0) {
        return Ok(StoredCounts::default());
    }
    let events = events.map(|events| events.min(MAX_MISSING_EVENTS));
    let missing = events.unwrap_or_default();
    sqlx::query("INSERT INTO gap (host, from_ns, to_ns, count, reason) VALUES (?1, ?2, ?2, ?3, ?4)")
        .bind(host)
        .bind(now.unix_nanos())
        .bind(column(missing))
        .bind(reason)
        .execute(&mut *connection)
        .await?;
    let subject = match events {
        Some(events) => format!("{} missing", counted(events, "event")),
        None => "an unknown number of events is missing".to_owned(),
    };
    sqlx::query("INSERT INTO incident (host, at_ns, kind, text) VALUES (?, ?, ?, ?)")
        .bind(host)
        .bind(now.unix_nanos())
        .bind(IncidentKind::Gap.name())
        .bind(format!("{subject}: {reason}"))
        .execute(connection)
        .await?;
    let unknown_gaps = u64::from(events.is_none());
    let (in_other_database, unknown_gaps_in_other_database) =
        if reason.starts_with(other_database_prefix!()) { (missing, unknown_gaps) } else { (0, 0) };
    Ok(StoredCounts {
        gaps: 1,
        missing,
        in_other_database,
        unknown_gaps,
        unknown_gaps_in_other_database,
        ..StoredCounts::default()
    })
}

/// Stores a batch whose events cannot be stored. `events` is the number of events if they can be decoded.
pub(super) async fn insert_quarantined_batch(
    connection: &mut SqliteConnection,
    host: i64,
    head: BatchHead,
    (events, frame): (Option<usize>, &Bytes),
    reason: &str,
    now: WallTime,
) -> Result<(), Refusal> {
    sqlx::query(
        "INSERT INTO quarantine (host, stream, number, received_ns, events, reason, frame) VALUES (?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(host)
    .bind(head.stream.to_string())
    .bind(column(head.number))
    .bind(now.unix_nanos())
    .bind(events.map(|events| events as i64))
    .bind(reason)
    .bind(frame.as_ref())
    .execute(&mut *connection)
    .await?;
    sqlx::query("DELETE FROM quarantine WHERE id <= (SELECT max(id) FROM quarantine) - ?")
        .bind(MAX_QUARANTINED)
        .execute(connection)
        .await?;
    Ok(())
}
