//! Quarantine of batches that cannot be stored. Such a batch is kept as it arrived, and its events are recorded as
//! missing.

use std::collections::BTreeMap;

use bytes::Bytes;
use peernet_clock::WallTime;
use peernet_logger::RunId;
use peernet_stream::{BatchHead, Event, Gap, codec};
use sqlx::SqliteConnection;

use super::entities::{Entities, Reporter};
use super::prepared::PreparedBatch;
use super::{Refusal, UnstorableBatch, records};
use crate::stored::StoredCounts;

/// A batch to be quarantined.
pub(super) struct RejectedBatch<'a> {
    pub(super) head: BatchHead,
    frame: Bytes,
    events: Option<Vec<Event>>,
    reason: &'a str,
}

impl<'a> RejectedBatch<'a> {
    /// Creates the value for a batch that was found invalid before it reached the database.
    pub(super) fn from_unstorable(unstorable: &'a UnstorableBatch) -> Self {
        let events =
            unstorable.body.as_ref().and_then(|body| codec::decode_events(body, unstorable.head.events).ok());
        Self { head: unstorable.head, frame: unstorable.frame.clone(), events, reason: &unstorable.reason }
    }

    /// Creates the value for a batch that the database refused.
    pub(super) fn from_refused(batch: &PreparedBatch, reason: &'a str) -> Self {
        let (head, body) = (batch.head, &batch.body);
        // The received frame is dropped when a batch is prepared, so a frame with the same events is encoded.
        let compress = false;
        let frame = Bytes::from(codec::encode_batch(&head, body, compress));
        Self { head, frame, events: codec::decode_events(body, head.events).ok(), reason }
    }

    /// Returns the reason why the batch cannot be stored.
    pub(super) fn reason(&self) -> &str {
        self.reason
    }

    /// Stores the frame and records its events as missing. If the events can be decoded, there is a gap for each run.
    /// Otherwise there is one gap with the number of events in the head, or without a number if the frame is too short
    /// for that many events. Returns the additions to the counters of the host.
    pub(super) async fn store(
        self,
        connection: &mut SqliteConnection,
        entities: &mut Entities,
        reporter: Reporter,
        now: WallTime,
    ) -> Result<StoredCounts, Refusal> {
        let content = (self.events.as_ref().map(Vec::len), &self.frame);
        records::insert_quarantined_batch(connection, reporter.row, self.head, content, self.reason, now)
            .await?;
        let new_gap = |run, at, count| Gap {
            pipeline: None,
            run,
            from: at,
            to: at,
            count,
            reason: format!("a batch was quarantined: {}", self.reason),
        };
        let gaps = match &self.events {
            Some(events) => {
                let mut runs = BTreeMap::<Option<RunId>, Gap>::new();
                for event in events {
                    let (run, at) = (event.origin().run, event_time(event));
                    let run = match run {
                        // An unknown run is not created for events that are not stored. These events
                        // count in the gap without a run.
                        Some(run) => entities.find_run(connection, reporter, run).await?.and(Some(run)),
                        None => None,
                    };
                    let at = at.unwrap_or(now);
                    let gap = runs.entry(run).or_insert_with(|| new_gap(run, at, 0));
                    (gap.from, gap.to) = (gap.from.min(at), gap.to.max(at));
                    gap.count += 1;
                }
                runs.into_values().collect()
            }
            None => {
                let stated_count = self.head.events as usize;
                // An event takes at least one byte.
                let count = if stated_count <= self.frame.len() { stated_count as u64 } else { 0 };
                vec![new_gap(None, now, count)]
            }
        };
        for gap in &gaps {
            records::insert_gap(connection, entities, reporter, gap).await?;
        }
        Ok(StoredCounts {
            quarantined: 1,
            gaps: gaps.len() as u64,
            missing: gaps.iter().map(|gap| gap.count).sum(),
            // The count 0 means that the number of missing events is unknown.
            unknown_gaps: gaps.iter().filter(|gap| gap.count == 0).count() as u64,
            ..StoredCounts::default()
        })
    }
}

/// Returns the time of an event on its host's clock.
fn event_time(event: &Event) -> Option<WallTime> {
    match event {
        Event::RunStarted(run) => Some(run.started),
        Event::RunEnded(end) => Some(end.ended),
        Event::Iteration(iteration) => iteration.tree.anchors().first().map(|edge| edge.wall),
        Event::Incident(incident) => Some(incident.at),
        Event::Gap(gap) => Some(gap.to),
        Event::Clock(sample) => Some(sample.at),
    }
}
