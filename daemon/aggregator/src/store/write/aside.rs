//! What is missing because a batch was put aside.

use std::collections::BTreeMap;

use peernet_clock::WallTime;
use peernet_logger::RunId;
use peernet_logger::stream::codec;
use peernet_logger::stream::{Event, Gap};
use sqlx::SqliteConnection;

use super::entities::Entities;
use super::{Refusal, Work, records};

/// Records the events of a batch that was put aside as missing: by run where it can be read, else as many as its head
/// claims. Returns how many gaps and how many events.
pub(super) async fn gaps(
    connection: &mut SqliteConnection,
    entities: &mut Entities,
    host: i64,
    work: &Work,
    reason: &str,
    now: WallTime,
) -> Result<(u64, u64), Refusal> {
    let gap = |run, count| Gap {
        pipeline: None,
        run,
        from: now,
        to: now,
        count,
        reason: format!("a batch was put aside: {reason}"),
    };
    let gaps = match work {
        Work::Batch(batch) => {
            let mut runs = BTreeMap::<Option<RunId>, Gap>::new();
            for event in &batch.events {
                let (run, at) = scope(event);
                let run = match run {
                    Some(run) => {
                        entities.known_run(connection, run).await?.filter(|it| it.is_of(host)).map(|_| run)
                    }
                    None => None,
                };
                let at = at.unwrap_or(now);
                let known = runs.entry(run).or_insert_with(|| Gap { from: at, to: at, ..gap(run, 0) });
                (known.from, known.to) = (known.from.min(at), known.to.max(at));
                known.count += 1;
            }
            runs.into_values().collect()
        }
        Work::Unreadable { frame, .. } => vec![gap(None, codec::batch_events(frame).unwrap_or(0))],
        Work::Hello { .. } | Work::Goodbye(_) | Work::Name(_) | Work::Missing(_) => Vec::new(),
    };
    for gap in &gaps {
        records::gap(connection, entities, host, gap).await?;
    }
    Ok((gaps.len() as u64, gaps.iter().map(|gap| gap.count).sum()))
}

/// The run that an event concerns, and when it happened.
fn scope(event: &Event) -> (Option<RunId>, Option<WallTime>) {
    match event {
        Event::RunStarted(run) => (Some(run.run), Some(run.started)),
        Event::RunEnded(end) => (Some(end.run), Some(end.ended)),
        Event::Iteration(iteration) => {
            (Some(iteration.run), iteration.tree.anchors().first().map(|edge| edge.wall))
        }
        Event::Incident(incident) => (incident.run, Some(incident.at)),
        Event::Gap(gap) => (gap.run, Some(gap.to)),
        Event::Clock(sample) => (None, Some(sample.at)),
    }
}
