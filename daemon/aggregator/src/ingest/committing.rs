//! The task that owns the writer: collects batches of many agents and commits them together.

use std::time::Duration;

use peernet_clock::SharedClock;
use tokio::sync::{mpsc, watch};
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use super::queue::Queued;
use crate::aggregator::Readiness;
use crate::store::write::{CommitError, Committed, Work, Writer};

/// The first pause after a failed commit, and the longest.
const FIRST_PAUSE: Duration = Duration::from_millis(200);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// How often the database's path is checked while there is nothing to store.
const CHECK_FILE_EVERY: Duration = Duration::from_secs(1);

/// When a group is large or old enough.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grouping {
    /// Longest time that the first of a group waits for others.
    pub(crate) interval: Duration,
    /// Nodes after which a group waits for no more.
    pub(crate) nodes: usize,
}

/// Commits until no more work will come and all that came is stored.
///
/// While the database refuses, the same group is tried again and nothing is acknowledged: agents keep what they sent.
/// When told to stop, the group is tried a last time and then left to them.
pub(crate) async fn run(
    mut writer: Writer,
    mut queue: mpsc::Receiver<Queued>,
    committed: mpsc::Sender<Committed>,
    ready: watch::Sender<Readiness>,
    grouping: Grouping,
    (clock, stop): (SharedClock, CancellationToken),
) {
    let mut checking = tokio::time::interval(CHECK_FILE_EVERY);
    checking.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        let first = tokio::select! {
            biased;
            first = queue.recv() => first,
            _ = checking.tick() => {
                check_file(&writer, &ready);
                continue;
            }
        };
        let Some(first) = first else { return };
        let group = gather(first, &mut queue, grouping).await;
        let (work, room): (Vec<Work>, Vec<_>) = group.into_iter().map(Queued::into_parts).unzip();
        let mut pause = FIRST_PAUSE;
        loop {
            match writer.commit(&work, clock.wall()).await {
                Ok(stored) => {
                    set(&ready, Readiness::Ready);
                    for (head, reason) in &stored.quarantined {
                        tracing::error!(host = %head.host, number = head.number, %reason, "a batch was put aside");
                    }
                    // Closed only while everything ends.
                    let _ended = committed.send(stored).await;
                    break;
                }
                Err(error) => {
                    let reason = words(&error);
                    if stop.is_cancelled() {
                        tracing::error!(batches = work.len(), %reason, "gave up storing: told to stop");
                        return;
                    }
                    set(&ready, Readiness::NotStoring(reason));
                    tokio::select! {
                        () = tokio::time::sleep(pause) => pause = (pause * 2).min(LONGEST_PAUSE),
                        () = stop.cancelled() => {}
                    }
                }
            }
        }
        drop(room);
    }
}

/// Tells of a file that was moved away even while there is nothing to store.
fn check_file(writer: &Writer, ready: &watch::Sender<Readiness>) {
    match writer.check_file() {
        Ok(()) => set(ready, Readiness::Ready),
        Err(error) => set(ready, Readiness::NotStoring(words(&error))),
    }
}

fn words(error: &CommitError) -> String {
    format!("cannot store events: {error}; agents keep them, tried again by itself")
}

/// The group that begins with `first`.
async fn gather(first: Queued, queue: &mut mpsc::Receiver<Queued>, grouping: Grouping) -> Vec<Queued> {
    let mut nodes = first.work.weight();
    let mut group = vec![first];
    let patience = tokio::time::sleep(grouping.interval);
    tokio::pin!(patience);
    while nodes < grouping.nodes {
        tokio::select! {
            biased;
            next = queue.recv() => match next {
                Some(next) => {
                    nodes += next.work.weight();
                    group.push(next);
                }
                None => break,
            },
            () = &mut patience => break,
        }
    }
    group
}

/// Logs changes of readiness, once each.
fn set(ready: &watch::Sender<Readiness>, now: Readiness) {
    ready.send_if_modified(|was| {
        if *was == now {
            return false;
        }
        match &now {
            Readiness::Ready => tracing::info!("storing events again"),
            Readiness::NotStoring(reason) => tracing::error!("{reason}"),
        }
        *was = now;
        true
    });
}
