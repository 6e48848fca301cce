//! Losses of an earlier process that was killed. The losses are determined when the spool is opened, and this process
//! reports them.

use peernet_clock::WallTime;
use peernet_logger::RunId;
use peernet_stream::{Gap, KILLED_REASON, RunCounts, SettledEvents, SpoolState, UnresolvedBatches};
use sqlx::{FromRow, SqliteConnection};

use crate::event_queue::counter::{self, CountOwner, EventCounter};

/// State that the previous process left in the file.
#[derive(FromRow)]
struct PreviousProcess {
    /// Name of the file in which the process counted its events.
    counter: Option<String>,
    /// Counts of the process's settled events by run, as encoded by [`encode_counts`].
    #[sqlx(rename = "counted")]
    settled_counts: Option<Vec<u8>>,
    /// Number of those settled events that are in batches.
    #[sqlx(rename = "taken")]
    batched: Option<i64>,
    /// Time of the last settled event.
    #[sqlx(rename = "counted_ns")]
    last_settled_ns: Option<i64>,
}

/// The unresolved batches of an earlier process, as stored in the file; see [`UnresolvedBatches`].
#[derive(FromRow)]
struct UnresolvedRow {
    /// Name of the file in which the process counted its events.
    counter: String,
    #[sqlx(rename = "counted")]
    settled_counts: Vec<u8>,
    #[sqlx(rename = "taken")]
    batched: i64,
    #[sqlx(rename = "counted_ns")]
    last_settled_ns: Option<i64>,
    #[sqlx(rename = "told")]
    reported_drops: i64,
    /// Number of events in all batches that were written to the spool.
    #[sqlx(rename = "events")]
    spooled_events: i64,
}

/// A loss that no gap has reported yet.
#[derive(FromRow)]
struct UnreportedLoss {
    pipeline: Option<String>,
    run: Option<String>,
    from_ns: i64,
    to_ns: i64,
    count: i64,
    reason: String,
}

/// Encodes counts for a column: the total, then the id and the number of events of each run.
pub(super) fn encode_counts(counts: &RunCounts) -> Vec<u8> {
    let mut bytes = counts.total.to_be_bytes().to_vec();
    for (run, events) in &counts.runs {
        bytes.extend(run.as_bytes());
        bytes.extend(events.to_be_bytes());
    }
    bytes
}

fn decode_counts(bytes: &[u8]) -> Option<RunCounts> {
    let (total, runs) = bytes.split_first_chunk()?;
    let mut counts = RunCounts { total: u64::from_be_bytes(*total), ..RunCounts::default() };
    // 16 bytes of the run's id and 8 bytes of its number of events.
    for entry in runs.chunks_exact(24) {
        let (run, events) = entry.split_first_chunk::<16>()?;
        counts.runs.insert(RunId::from_bytes(*run), u64::from_be_bytes(*events.first_chunk()?));
    }
    Some(counts)
}

/// Returns the losses that no gap has reported yet, in the order in which they will be reported.
pub(super) async fn read_unreported(connection: &mut SqliteConnection) -> Result<Vec<Gap>, sqlx::Error> {
    let rows: Vec<UnreportedLoss> = sqlx::query_as(
        "SELECT pipeline, run, from_ns, to_ns, count, reason FROM unreported ORDER BY told_through",
    )
    .fetch_all(connection)
    .await?;
    let gap = |row: UnreportedLoss| Gap {
        pipeline: row.pipeline.and_then(|name| name.parse().ok()),
        run: row.run.and_then(|id| id.parse().ok()),
        from: WallTime::from_unix_nanos(row.from_ns),
        to: WallTime::from_unix_nanos(row.to_ns),
        count: row.count.cast_unsigned(),
        reason: row.reason,
    };
    Ok(rows.into_iter().map(gap).collect())
}

/// Returns the unresolved batches of an earlier process: only the aggregator knows whether they are lost. `None` if
/// there are none, if the process's file of counts no longer exists because the host was restarted, or if this spool is
/// a copy and the file belongs to the original spool.
pub(super) async fn read_unresolved(
    connection: &mut SqliteConnection,
    owner: &CountOwner,
) -> Result<Option<UnresolvedBatches>, sqlx::Error> {
    let row: Option<UnresolvedRow> =
        sqlx::query_as("SELECT counter, counted, taken, counted_ns, told, events FROM unresolved")
            .fetch_optional(connection)
            .await?;
    Ok(row.and_then(|row| {
        Some(UnresolvedBatches {
            counted: counter::read(&row.counter, owner)?,
            settled: SettledEvents {
                events: decode_counts(&row.settled_counts).unwrap_or_default(),
                batched: row.batched.cast_unsigned(),
                last: row.last_settled_ns.map(WallTime::from_unix_nanos),
            },
            reported_drops: row.reported_drops.cast_unsigned(),
            spooled_events: row.spooled_events.cast_unsigned(),
        })
    }))
}

/// Returns the name of the file in which the process with unresolved batches counted its events.
pub(super) async fn unresolved_counter(
    connection: &mut SqliteConnection,
) -> Result<Option<String>, sqlx::Error> {
    sqlx::query_scalar("SELECT counter FROM unresolved").fetch_optional(connection).await
}

/// Determines which events the previous process lost, records them, and starts a new counter. The record is one
/// transaction, so that each loss is reported exactly once, no matter when a process is killed. If shared memory is
/// unavailable, events are not counted. A copy of a spool does not use the counts of the original spool, whose agent
/// reports the losses itself.
pub(super) async fn start_counter(
    connection: &mut SqliteConnection,
    state: &mut SpoolState,
    owner: &CountOwner,
) -> Result<EventCounter, sqlx::Error> {
    let mut previous: PreviousProcess =
        sqlx::query_as("SELECT counter, counted, taken, counted_ns FROM stream WHERE id = 1")
            .fetch_one(&mut *connection)
            .await?;
    if previous.counter.take_if(|name| counter::belongs_to_another_spool(name, owner)).is_some() {
        tracing::warn!(
            "the spool is a copy: the count of queued events belongs to the original spool, whose agent reports the events that \
             were lost"
        );
    }
    // Number of lost events; `None` if only the aggregator knows it.
    let mut lost_events = Some(0);
    let counted_events = previous.counter.as_deref().and_then(|name| counter::read(name, owner));
    if let Some(counted_events) = counted_events {
        let events = previous.settled_counts.as_deref().and_then(decode_counts).unwrap_or_default();
        let batched = previous.batched.unwrap_or_default().cast_unsigned();
        let last = previous.last_settled_ns.map(WallTime::from_unix_nanos);
        lost_events =
            state.record_losses_of_killed_process(counted_events, SettledEvents { events, batched, last });
    }
    let counter = EventCounter::create(owner).unwrap_or_else(|error| {
        tracing::warn!(%error, "cannot count events in shared memory; if the agent is killed, its lost events are not reported");
        EventCounter::default()
    });
    sqlx::query("BEGIN IMMEDIATE").execute(&mut *connection).await?;
    // The name of the new counter is part of the transaction. If this process is killed after the commit, the next
    // process finds the counter and reads the count from it.
    let result = match write_state(connection, state, lost_events.is_none(), &counter).await {
        Ok(()) => sqlx::query("COMMIT").execute(&mut *connection).await.map(drop),
        error => error,
    };
    if let Err(error) = result {
        counter.remove();
        if let Err(error) = sqlx::query("ROLLBACK").execute(connection).await {
            tracing::debug!(%error, "nothing to roll back in the spool");
        }
        return Err(error);
    }
    match (lost_events, &previous.counter) {
        (None, _) => tracing::warn!(
            "the agent was killed while it sent events that its spool could not store: the aggregator reports which of these events \
             are stored, and a gap reports the other events"
        ),
        (Some(lost_events), Some(name)) => {
            // The file is removed after the commit: if this process is killed before the commit, the next process needs
            // the file.
            counter::remove(name);
            if lost_events > 0 {
                tracing::warn!(
                    events = lost_events,
                    "the agent was killed before these events reached its spool; a gap reports them"
                );
            }
        }
        (Some(_), None) => {}
    }
    // Files of counts whose spool was deleted would stay in shared memory until the host restarts.
    let (unresolved_file, current_file) = (unresolved_counter(connection).await?, counter.name());
    let needed_files: Vec<&str> =
        [&unresolved_file, &current_file].into_iter().filter_map(Option::as_deref).collect();
    counter::remove_abandoned(owner, &needed_files);
    Ok(counter)
}

/// Writes the state. `previous_is_unresolved` is `true` if [`SpoolState::unresolved`] now has the batches of the
/// previous process.
async fn write_state(
    connection: &mut SqliteConnection,
    state: &SpoolState,
    previous_is_unresolved: bool,
    counter: &EventCounter,
) -> Result<(), sqlx::Error> {
    match &state.unresolved {
        None => sqlx::query("DELETE FROM unresolved").execute(&mut *connection).await.map(drop)?,
        Some(unresolved) if previous_is_unresolved => {
            sqlx::query(
                "INSERT OR REPLACE INTO unresolved (id, counter, counted, taken, counted_ns, told, events) \
                 SELECT id, counter, coalesce(counted, ?), coalesce(taken, 0), counted_ns, ?, ? FROM stream",
            )
            .bind(encode_counts(&RunCounts::default()))
            .bind(unresolved.reported_drops.cast_signed())
            .bind(unresolved.spooled_events.cast_signed())
            .execute(&mut *connection)
            .await?;
        }
        // These batches belong to a process before the previous one, and are in the table already.
        Some(_) => {}
    }
    sqlx::query(
        "UPDATE stream SET produced = ?, dropped = ?, told = ?, counter = ?, counted = NULL, taken = NULL, \
         counted_ns = NULL WHERE id = 1",
    )
    .bind(state.totals.produced.cast_signed())
    .bind(state.totals.dropped.cast_signed())
    .bind(state.totals.reported_drops.cast_signed())
    .bind(counter.name())
    .execute(&mut *connection)
    .await?;
    write_unreported(connection, state.totals.reported_drops, &state.unreported).await
}

/// Replaces the losses that no gap has reported yet. `reported_through` is the number of dropped events that gaps have
/// reported so far.
async fn write_unreported(
    connection: &mut SqliteConnection,
    mut reported_through: u64,
    unreported: &[Gap],
) -> Result<(), sqlx::Error> {
    // Losses that are already in the table `unreported` are subtracted, because the column `lost_when_killed` already
    // contains them.
    let lost_when_killed: u64 =
        unreported.iter().filter(|gap| gap.reason == KILLED_REASON).map(|gap| gap.count).sum();
    sqlx::query(
        "UPDATE stream SET lost_when_killed = lost_when_killed + ? - \
         (SELECT coalesce(sum(count), 0) FROM unreported WHERE reason = ?) WHERE id = 1",
    )
    .bind(lost_when_killed.cast_signed())
    .bind(KILLED_REASON)
    .execute(&mut *connection)
    .await?;
    sqlx::query("DELETE FROM unreported").execute(&mut *connection).await?;
    for gap in unreported {
        reported_through += gap.count;
        sqlx::query(
            "INSERT INTO unreported (told_through, pipeline, run, from_ns, to_ns, count, reason) \
             VALUES (?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(reported_through.cast_signed())
        .bind(gap.pipeline.as_ref().map(ToString::to_string))
        .bind(gap.run.map(|run| run.to_string()))
        .bind(gap.from.unix_nanos())
        .bind(gap.to.unix_nanos())
        .bind(gap.count.cast_signed())
        .bind(gap.reason.as_str())
        .execute(&mut *connection)
        .await?;
    }
    Ok(())
}

/// Records in the current transaction that the batches of the earlier process are resolved, and the losses to report.
pub(super) async fn resolve(
    connection: &mut SqliteConnection,
    reported_drops: u64,
    unreported: &[Gap],
) -> Result<(), sqlx::Error> {
    sqlx::query("DELETE FROM unresolved").execute(&mut *connection).await?;
    write_unreported(connection, reported_drops, unreported).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_read_back_as_written() {
        let mut counts = RunCounts::default();
        counts.add(Some(RunId::random()), 7);
        counts.add(Some(RunId::random()), 1 << 40);
        counts.add(None, 2);
        assert_eq!(decode_counts(&encode_counts(&counts)), Some(counts));
        assert_eq!(decode_counts(&[1, 2]), None);
    }
}
