//! The task that owns the writer: collects batches of many agents and commits them together.

use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{SharedClock, Stamp};
use peernet_logger::HostId;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use super::connection_log::ConnectionLog;
use super::preparing::Queued;
use super::reopening::Reopening;
use crate::config::AggregatorConfig;
use crate::picture::Picture;
use crate::readiness::Readiness;
use peernet_store::writing::{
    CommitError, Committed, Integrity, OpenDatabase, PendingIncidents, Step, StoredState, Work, Writer,
};
use peernet_store::{AggregatorIncidentKind, StoreError};

/// The first pause after a failed attempt, and the longest.
const FIRST_PAUSE: Duration = Duration::from_millis(200);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// How often the database's files are looked at while there is nothing to store.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Bytes of the log's file above which it is emptied as soon as nobody reads: twice what it usually has.
const MOST_LOG_BYTES: u64 = 128 << 20;

/// Nodes of a commit at most, unless it is configured to wait for more: beyond that a larger one is no cheaper.
const MOST_NODES: usize = 100_000;

/// Commits after which what is old is deleted even though work waits.
const RETAIN_EVERY: u64 = 8;

/// When a group is large or old enough.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grouping {
    /// Longest time that the first of a group waits for others.
    pub(crate) interval: Duration,
    /// Nodes after which a group waits for no more, and takes only what is there.
    pub(crate) enough: usize,
    /// Nodes after which a group takes no more.
    pub(crate) most: usize,
}

impl Grouping {
    pub(crate) fn new(config: &AggregatorConfig) -> Self {
        let enough = config.commit_nodes;
        Self { interval: config.commit_interval(), enough, most: enough.max(MOST_NODES) }
    }
}

/// What is asked of the writer beside storing.
#[derive(Debug)]
pub(crate) enum Errand {
    /// Keep a run whatever its age, or no longer; answers whether there is such a run.
    Pin(i64, bool, oneshot::Sender<Result<bool, StoreError>>),
}

/// What the writer tells ingest, in the order in which it happened.
#[derive(Debug)]
pub(crate) enum StoreEvent {
    /// A transaction is on disk.
    Committed(Committed),
    /// The database was closed, to be opened anew.
    Closed,
    /// The database was opened anew, and holds this.
    Opened(Box<StoredState>),
}

/// Pauses between attempts, each twice as long as the one before, until one succeeds.
#[derive(Debug)]
pub(super) struct Backoff(Duration);

impl Backoff {
    const fn new() -> Self {
        Self(FIRST_PAUSE)
    }

    /// The next pause.
    pub(super) fn next(&mut self) -> Duration {
        let pause = self.0;
        self.0 = (pause * 2).min(LONGEST_PAUSE);
        pause
    }
}

/// What the writer's task is wired to.
pub(crate) struct Wires {
    pub(crate) queue: mpsc::Receiver<Queued>,
    pub(crate) errands: mpsc::Receiver<Errand>,
    pub(crate) stored: mpsc::Sender<StoreEvent>,
    pub(crate) ready: watch::Sender<Readiness>,
    /// Of the live picture, which tells of connections.
    pub(crate) pictures: watch::Receiver<Arc<Picture>>,
    pub(crate) clock: SharedClock,
    pub(crate) integrity: Integrity,
    pub(crate) stop: CancellationToken,
}

/// Why the writer's task does not go on with a database.
enum Ended {
    /// All that came is stored, or the task was told to stop.
    Finished,
    /// The database has to be opened anew.
    Failed(CommitError),
}

/// What outlives a database that is opened anew.
#[derive(Debug)]
struct Carried {
    /// How often that was done.
    generation: u64,
    /// Hosts that took their leave, which could not be stored.
    departed: Vec<HostId>,
    backoff: Backoff,
    /// Of the aggregator itself.
    incidents: PendingIncidents,
    connections: ConnectionLog,
    /// Since when nothing can be stored, and why; `None` while it can.
    outage: Option<(Stamp, String)>,
}

impl Carried {
    /// Whether work goes with the database that is open. What was let in before is compared with the marks of the one
    /// before; only that a host has left is true of any.
    fn is_current(&self, queued: &Queued) -> bool {
        queued.generation == self.generation || matches!(queued.work, Work::Goodbye(_))
    }

    /// Nothing can be stored.
    fn fails(&mut self, error: &CommitError, now: Stamp) {
        self.outage.get_or_insert_with(|| (now, error.to_string()));
    }

    /// Something was stored. An outage that anybody could notice is an incident.
    fn works(&mut self, now: Stamp) {
        self.backoff = Backoff::new();
        let Some((since, reason)) = self.outage.take() else { return };
        let seconds = (now.mono - since.mono).seconds();
        if seconds >= 1.0 {
            let text = format!("nothing could be stored for {seconds:.0} s: {reason}");
            self.incidents.add(AggregatorIncidentKind::Storage, since.wall, text);
        }
    }
}

/// Commits until no more work will come and all that came is stored.
///
/// While the database refuses, the same group is tried again and nothing is acknowledged: agents keep what they sent.
/// When the file fails or is replaced, the database is closed and opened anew, like in a restart of the process: what
/// was let in before is dropped, and the agents send it again as far as it is not stored. When told to stop, the group
/// is tried a last time and then left to them. Gives the database back, to be closed, if it is open.
pub(crate) async fn run(
    mut database: OpenDatabase,
    mut wires: Wires,
    grouping: Grouping,
    reopening: Reopening,
) -> Option<OpenDatabase> {
    let incidents = PendingIncidents::new(wires.clock.stamp());
    let mut carried = Carried {
        generation: 0,
        departed: Vec::new(),
        backoff: Backoff::new(),
        incidents,
        connections: ConnectionLog::default(),
        outage: None,
    };
    loop {
        match serve(&mut database.writer, &mut wires, grouping, &mut carried).await {
            Ended::Finished => return Some(database),
            Ended::Failed(error) => {
                carried.fails(&error, wires.clock.stamp());
                let reopened = reopening.reopen(database, &error, &mut wires, &mut carried.backoff);
                // Large, and rarely needed.
                database = Box::pin(reopened).await?;
                carried.generation += 1;
            }
        }
    }
}

/// Commits with one database.
async fn serve(writer: &mut Writer, wires: &mut Wires, grouping: Grouping, carried: &mut Carried) -> Ended {
    let mut looking = tokio::time::interval(LOOK_EVERY);
    looking.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut commits, mut more) = (0_u64, Step::More);
    let mut damaged = false;
    loop {
        let mut group = Vec::new();
        if carried.departed.is_empty() {
            let first = tokio::select! {
                biased;
                Some(errand) = wires.errands.recv() => {
                    run_errand(writer, errand, &wires.integrity).await;
                    continue;
                }
                first = wires.queue.recv() => first,
                () = std::future::ready(()), if more == Step::More => {
                    more = retain(writer, wires).await;
                    continue;
                }
                _ = looking.tick() => {
                    match look_after(writer, wires, carried).await {
                        Ok(()) if damaged => set(&wires.ready, Readiness::Ready),
                        Ok(()) => {}
                        Err(error @ CommitError::Damaged(_)) => set(&wires.ready, why_not(&error)),
                        Err(error) => return Ended::Failed(error),
                    }
                    damaged = wires.integrity.damage().is_some();
                    more = Step::More;
                    continue;
                }
            };
            let Some(first) = first else { return Ended::Finished };
            let waited = (wires.clock.mono() - first.since).to_duration();
            group = gather(first, &mut wires.queue, waited, grouping).await;
            group.retain(|queued| carried.is_current(queued));
        }
        let mut work: Vec<Work> = carried.departed.drain(..).map(Work::Goodbye).collect();
        let (of_group, room): (Vec<Work>, Vec<_>) = group.into_iter().map(|it| (it.work, it.room)).unzip();
        work.extend(of_group);
        if work.is_empty() {
            continue;
        }
        match store(writer, &work, wires, carried).await {
            Ok(true) => {}
            Ok(false) => return Ended::Finished,
            Err(error) => {
                let left = |work| if let Work::Goodbye(host) = work { Some(host) } else { None };
                carried.departed = work.into_iter().filter_map(left).collect();
                return Ended::Failed(error);
            }
        }
        drop((work, room));
        commits += 1;
        more = Step::More;
        if commits.is_multiple_of(RETAIN_EVERY) {
            more = retain(writer, wires).await;
            match look_after(writer, wires, carried).await {
                // The next commit tells.
                Ok(()) | Err(CommitError::Damaged(_)) => {}
                Err(error) => return Ended::Failed(error),
            }
        }
    }
}

/// Sees that the file is still where it was, also while nothing is stored, that the log is not too long, and that the
/// clocks and the statistics of connections are stored.
///
/// # Errors
/// When the database has to be opened anew, or is damaged.
async fn look_after(writer: &mut Writer, wires: &Wires, carried: &mut Carried) -> Result<(), CommitError> {
    writer.check_file()?;
    undamaged(&wires.integrity)?;
    let looked_after = async {
        writer.keep_clocks(wires.clock.stamp(), &mut carried.incidents).await?;
        let connections = carried.connections.observe(&wires.pictures.borrow(), wires.clock.mono());
        if !connections.is_empty() {
            writer.store_connections(&connections).await?;
        }
        writer.bound_log(MOST_LOG_BYTES).await
    };
    looked_after.await.or_else(|error: CommitError| {
        // A full disk shows at the next commit.
        if error.leaves_connection_usable() { Ok(()) } else { Err(error) }
    })
}

/// Deletes a little of what is old. What fails is tried again at the next occasion.
async fn retain(writer: &mut Writer, wires: &Wires) -> Step {
    // Freed pages are written to: what can still be salvaged stays as it is.
    if wires.integrity.damage().is_some() {
        return Step::Done;
    }
    writer.retain(wires.clock.stamp()).await.unwrap_or_else(|error| {
        wires.integrity.note(&error);
        tracing::warn!(%error, "cannot delete what is old, tried again by itself");
        Step::Done
    })
}

/// Stores a group, however long that takes; whether it was before the task had to end.
///
/// # Errors
/// When the database has to be opened anew for that.
async fn store(
    writer: &mut Writer,
    work: &[Work],
    wires: &mut Wires,
    carried: &mut Carried,
) -> Result<bool, CommitError> {
    loop {
        let error = match commit(writer, work, wires).await {
            Ok(stored) => {
                carried.works(wires.clock.stamp());
                set(&wires.ready, Readiness::Ready);
                for (head, reason) in &stored.quarantined {
                    tracing::error!(host = %head.host, number = head.number, %reason, "a batch was put aside");
                }
                // Closed only while everything ends.
                let _ended = wires.stored.send(StoreEvent::Committed(stored)).await;
                return Ok(true);
            }
            Err(error) => error,
        };
        if wires.stop.is_cancelled() {
            tracing::error!(batches = work.len(), %error, "gave up storing: told to stop");
            return Ok(false);
        }
        if !error.leaves_connection_usable() {
            return Err(error);
        }
        carried.fails(&error, wires.clock.stamp());
        set(&wires.ready, why_not(&error));
        let again = tokio::time::sleep(carried.backoff.next());
        tokio::pin!(again);
        loop {
            tokio::select! {
                () = &mut again => break,
                () = wires.stop.cancelled() => break,
                Some(errand) = wires.errands.recv() => run_errand(writer, errand, &wires.integrity).await,
            }
        }
    }
}

/// Stores a group once, unless the file is damaged.
async fn commit(writer: &mut Writer, work: &[Work], wires: &Wires) -> Result<Committed, CommitError> {
    // One that was put in the place of a damaged file is opened.
    writer.check_file()?;
    undamaged(&wires.integrity)?;
    let committed = writer.commit(work, wires.clock.stamp()).await;
    if let Err(CommitError::Database(error)) = &committed {
        wires.integrity.note(error);
    }
    // What was committed while damage was found is not acknowledged: its agents keep it.
    undamaged(&wires.integrity)?;
    committed
}

fn undamaged(integrity: &Integrity) -> Result<(), CommitError> {
    integrity.refusal().map_or(Ok(()), |refusal| Err(CommitError::Damaged(refusal)))
}

async fn run_errand(writer: &mut Writer, errand: Errand, integrity: &Integrity) {
    match errand {
        Errand::Pin(run, pinned, answer) => {
            let answered = writer.pin(run, pinned, integrity).await;
            // Whoever asked may have gone.
            let _gone = answer.send(answered);
        }
    }
}

/// That a group cannot be stored, and why.
fn why_not(error: &CommitError) -> Readiness {
    match error {
        CommitError::Damaged(what) => {
            Readiness::NotStoring(format!("cannot store events: {what}; agents keep them"))
        }
        error => not_storing(error),
    }
}

/// That nothing is stored, and why.
pub(super) fn not_storing(error: &impl Display) -> Readiness {
    Readiness::NotStoring(format!("cannot store events: {error}; agents keep them, tried again by itself"))
}

/// The group that begins with `first`: what waits already, and what comes until the first has waited long enough since
/// it was let in. Under load that was during the commit before, so that nothing more is waited for. Nor is it where the
/// group is worth a sync already: its agents may have sent all that they are allowed, and wait for this commit.
async fn gather(
    first: Queued,
    queue: &mut mpsc::Receiver<Queued>,
    waited: Duration,
    grouping: Grouping,
) -> Vec<Queued> {
    let mut nodes = first.work.weight();
    let mut group = vec![first];
    let patience = tokio::time::sleep(grouping.interval.saturating_sub(waited));
    tokio::pin!(patience);
    while nodes < grouping.most {
        let next = if nodes >= grouping.enough {
            queue.try_recv().ok()
        } else {
            tokio::select! {
                biased;
                next = queue.recv() => next,
                () = &mut patience => None,
            }
        };
        let Some(next) = next else { break };
        nodes += next.work.weight();
        group.push(next);
    }
    group
}

/// Logs changes of readiness, once each.
pub(super) fn set(ready: &watch::Sender<Readiness>, now: Readiness) {
    ready.send_if_modified(|was| {
        if *was == now {
            return false;
        }
        match &now {
            Readiness::Ready => tracing::info!("storing events again"),
            Readiness::NotStoring(reason) => tracing::warn!("{reason}"),
        }
        *was = now;
        true
    });
}

#[cfg(test)]
mod tests {
    use peernet_clock::MonoTime;
    use tokio::sync::Semaphore;

    use super::*;

    const EVER: Duration = Duration::from_secs(3600);

    /// Weighs one node.
    fn piece() -> Queued {
        let room = Arc::new(Semaphore::new(2));
        let permit = || Arc::clone(&room).try_acquire_owned().expect("a permit");
        Queued {
            work: Work::Goodbye(HostId::random()),
            generation: 0,
            since: MonoTime::from_nanos(0),
            room: [permit(), permit()],
        }
    }

    async fn waiting(pieces: usize) -> (mpsc::Sender<Queued>, mpsc::Receiver<Queued>) {
        let (sender, receiver) = mpsc::channel(16);
        for _ in 0..pieces {
            sender.send(piece()).await.expect("there is room");
        }
        (sender, receiver)
    }

    #[tokio::test]
    async fn what_is_enough_takes_what_is_there_and_waits_for_nothing() {
        let (_more_may_come, mut queue) = waiting(4).await;
        let grouping = Grouping { interval: EVER, enough: 2, most: 100 };
        assert_eq!(gather(piece(), &mut queue, Duration::ZERO, grouping).await.len(), 5);
    }

    #[tokio::test]
    async fn too_little_waits_until_it_is_enough() {
        let (sender, mut queue) = waiting(1).await;
        let grouping = Grouping { interval: EVER, enough: 4, most: 100 };
        let group = tokio::spawn(async move { gather(piece(), &mut queue, Duration::ZERO, grouping).await });
        tokio::task::yield_now().await;
        assert!(!group.is_finished());
        for _ in 0..2 {
            sender.send(piece()).await.expect("it takes");
        }
        assert_eq!(group.await.expect("gathers").len(), 4);
    }

    #[tokio::test]
    async fn what_waited_its_time_goes_however_little_it_is() {
        let (_more_may_come, mut queue) = waiting(1).await;
        let grouping = Grouping { interval: EVER, enough: 100, most: 100 };
        assert_eq!(gather(piece(), &mut queue, EVER, grouping).await.len(), 2);
    }

    #[tokio::test]
    async fn no_group_takes_more_than_the_most() {
        let (_more_may_come, mut queue) = waiting(10).await;
        let grouping = Grouping { interval: EVER, enough: 2, most: 6 };
        assert_eq!(gather(piece(), &mut queue, Duration::ZERO, grouping).await.len(), 6);
    }
}
