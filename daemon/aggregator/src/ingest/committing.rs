//! The writer's task, the only owner of the writing connection: it commits the batches of several agents together
//! (group commit).
//!
//! A commit of any size costs one sync of the disk. A group consists of the batches that arrived while the
//! previous commit was syncing, so that groups grow with the load. A group of few tree nodes (rows) waits up to
//! `commit_interval_ms` for more batches, so that a quiet system does not sync at each batch. For a group of
//! `commit_nodes` nodes the sync is a small part of the cost. Such a group does not wait for more batches: its agents
//! may have used up their windows and may be waiting for this commit.
//!
//! Agents get their acknowledgements only after the commit. Nothing in this task waits for an agent.

use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{LogThrottle, SharedClock, Stamp};
use peernet_logger::HostId;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use super::backoff::Backoff;
use super::connection_log::ConnectionLog;
use super::preparing::PreparedWork;
use super::reopening::Reopening;
use crate::config::AggregatorConfig;
use crate::live_state::LiveState;
use crate::readiness::Readiness;
use peernet_store::writing::{
    CommitError, CommitResult, Integrity, OpenDatabase, PendingIncidents, StepResult, StoredState, Work,
    Writer,
};
use peernet_store::{AggregatorIncidentKind, StoreError};

/// Interval of checking the database's files while no work arrives.
const CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// Size of SQLite's -wal file above which the file is truncated as soon as no reader uses it, bytes. Twice the usual
/// size.
const MAX_WAL_BYTES: u64 = 128 << 20;

/// Maximum number of tree nodes of a commit, unless `commit_nodes` is larger: a larger commit is no cheaper per node.
const MAX_COMMIT_NODES: usize = 100_000;

/// Number of commits after which expired data is deleted even if work is waiting.
const COMMITS_PER_RETENTION: u64 = 8;

/// Limits at which a group is committed. Nodes are tree nodes (see [`Work::weight`]).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grouping {
    /// Longest time that the first batch of a group waits for further batches.
    pub(crate) interval: Duration,
    /// Number of nodes at which a group no longer waits for batches; batches that are ready still join the
    /// group.
    pub(crate) min_nodes: usize,
    /// Number of nodes at which a group is full.
    pub(crate) max_nodes: usize,
}

impl Grouping {
    pub(crate) fn new(config: &AggregatorConfig) -> Self {
        let min_nodes = config.commit_nodes;
        Self { interval: config.commit_interval(), min_nodes, max_nodes: min_nodes.max(MAX_COMMIT_NODES) }
    }
}

/// A request to the writer's task from other parts of the program.
#[derive(Debug)]
pub(crate) enum WriterRequest {
    /// Protects a run from the retention limits, or ends that protection. The answer is whether there is such a run.
    Pin(i64, bool, oneshot::Sender<Result<bool, StoreError>>),
}

/// A message from the writer's task to the ingest task. The channel keeps the order in which things happened.
#[derive(Debug)]
pub(crate) enum StoreEvent {
    /// A transaction is on disk.
    Committed(CommitResult),
    /// The database was closed and will be reopened.
    Closed,
    /// The database was reopened and contains this state.
    Opened(Box<StoredState>),
}

/// The channels and shared objects of the writer's task.
pub(crate) struct TaskContext {
    pub(crate) queue: mpsc::Receiver<PreparedWork>,
    pub(crate) requests: mpsc::Receiver<WriterRequest>,
    pub(crate) store_events: mpsc::Sender<StoreEvent>,
    pub(crate) readiness: watch::Sender<Readiness>,
    /// Snapshots of the live state, the source of the connections' statistics.
    pub(crate) snapshots: watch::Receiver<Arc<LiveState>>,
    pub(crate) clock: SharedClock,
    pub(crate) integrity: Integrity,
    pub(crate) stop: CancellationToken,
}

/// Reason for which the task stopped using a database.
enum ServeEnd {
    /// Everything received is stored, or the task was stopped.
    Finished,
    /// The database has to be reopened.
    Failed(CommitError),
}

/// State of the task that survives reopening the database.
#[derive(Debug)]
struct WriterState {
    /// Number of times that the database was reopened.
    generation: u64,
    /// Hosts whose goodbye could not be stored yet.
    departed_hosts: Vec<HostId>,
    backoff: Backoff,
    /// Incidents of the aggregator itself.
    incidents: PendingIncidents,
    connections: ConnectionLog,
    /// Limits the log lines about failed deletions: on a full disk, a deletion is tried every second.
    failed_deletions: LogThrottle,
    /// Start and reason of the current storage outage; `None` while commits succeed.
    outage: Option<(Stamp, String)>,
}

impl WriterState {
    /// Returns whether work belongs to the open database. Work admitted before a reopening was checked against the
    /// stored state of the previous database, so it is dropped. A goodbye is valid for any database.
    fn is_current(&self, prepared: &PreparedWork) -> bool {
        prepared.generation == self.generation || matches!(prepared.work, Work::Goodbye(_))
    }

    /// Records that nothing can be stored.
    fn record_failure(&mut self, error: &CommitError, now: Stamp) {
        self.outage.get_or_insert_with(|| (now, error.to_string()));
    }

    /// Records that a commit succeeded. An outage of at least one second becomes an incident.
    fn record_success(&mut self, now: Stamp) {
        self.backoff = Backoff::new();
        let Some((since, reason)) = self.outage.take() else { return };
        let seconds = (now.mono - since.mono).seconds();
        if seconds >= 1.0 {
            let text = format!("nothing could be stored for {seconds:.0} s: {reason}");
            self.incidents.add(AggregatorIncidentKind::Storage, since.wall, text);
        }
    }
}

/// Commits until the queue is closed and everything received is stored.
///
/// While the database refuses a group, the same group is retried and nothing is acknowledged, so the agents keep their
/// batches. When the file fails or is replaced, the database is closed and reopened as at a start of the process: work
/// admitted before is dropped, and the agents send it again if it is not stored. When `stop` is cancelled, the group is
/// tried once more and then left to the agents. Returns the database, if it is open, for closing.
pub(crate) async fn run(
    mut database: OpenDatabase,
    mut context: TaskContext,
    grouping: Grouping,
    reopening: Reopening,
) -> Option<OpenDatabase> {
    let incidents = PendingIncidents::new(context.clock.stamp());
    let mut state = WriterState {
        generation: 0,
        departed_hosts: Vec::new(),
        backoff: Backoff::new(),
        incidents,
        connections: ConnectionLog::default(),
        failed_deletions: LogThrottle::default(),
        outage: None,
    };
    loop {
        match serve(&mut database.writer, &mut context, grouping, &mut state).await {
            ServeEnd::Finished => return Some(database),
            ServeEnd::Failed(error) => {
                state.record_failure(&error, context.clock.stamp());
                let reopened = reopening.reopen(database, &error, &mut context, &mut state.backoff);
                // Boxed because the future is large and rarely needed.
                database = Box::pin(reopened).await?;
                state.generation += 1;
            }
        }
    }
}

/// Commits with one database until it has to be reopened or the work ends.
async fn serve(
    writer: &mut Writer,
    context: &mut TaskContext,
    grouping: Grouping,
    state: &mut WriterState,
) -> ServeEnd {
    let mut check_interval = tokio::time::interval(CHECK_INTERVAL);
    // A commit may take longer than the interval; checks that were missed need not be made up for.
    check_interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
    // `More` requests a step of retention. The first step comes at once, because the limits may have changed while the
    // aggregator was stopped. Each check and each commit requests further steps.
    let (mut commits, mut retention_step) = (0_u64, StepResult::More);
    // Whether damage was known at the previous check.
    let mut was_damaged = false;
    loop {
        let mut group = Vec::new();
        // Goodbyes that the previous database could not store are stored first, without other work.
        if state.departed_hosts.is_empty() {
            let first = tokio::select! {
                // Requests come first: they are rare, and their senders wait for the answer.
                biased;
                Some(request) = context.requests.recv() => {
                    execute_request(writer, request, &context.integrity).await;
                    continue;
                }
                first = context.queue.recv() => first,
                // Retention runs only while no work waits.
                () = std::future::ready(()), if retention_step == StepResult::More => {
                    retention_step = run_retention_step(writer, context, &mut state.failed_deletions).await;
                    continue;
                }
                _ = check_interval.tick() => {
                    match check_and_maintain(writer, context, state).await {
                        Ok(()) if was_damaged => set_readiness(&context.readiness, Readiness::Ready),
                        Ok(()) => {}
                        Err(error @ CommitError::Damaged(_)) => {
                            set_readiness(&context.readiness, readiness_after(&error));
                        }
                        Err(error) => return ServeEnd::Failed(error),
                    }
                    was_damaged = context.integrity.damage().is_some();
                    retention_step = StepResult::More;
                    continue;
                }
            };
            let Some(first) = first else { return ServeEnd::Finished };
            // Time in the queue counts towards the interval.
            let waited = (context.clock.mono() - first.admitted_at).to_duration();
            group = collect_group(first, &mut context.queue, waited, grouping).await;
            // Work that was admitted before a reopening is dropped here, so that a reopening needs no search through
            // the queue.
            group.retain(|prepared| state.is_current(prepared));
        }
        let mut work: Vec<Work> = state.departed_hosts.drain(..).map(Work::Goodbye).collect();
        let (group_work, capacity): (Vec<Work>, Vec<_>) =
            group.into_iter().map(|prepared| (prepared.work, prepared.capacity)).unzip();
        work.extend(group_work);
        if work.is_empty() {
            continue;
        }
        match store(writer, &work, context, state).await {
            Ok(true) => {}
            // The task was stopped before the group was stored.
            Ok(false) => return ServeEnd::Finished,
            Err(error) => {
                // Agents send batches again, but no goodbyes. Goodbyes are therefore kept for the reopened database.
                let departed_host = |work| if let Work::Goodbye(host) = work { Some(host) } else { None };
                state.departed_hosts = work.into_iter().filter_map(departed_host).collect();
                return ServeEnd::Failed(error);
            }
        }
        // Frees the capacity of the queue before retention, which may take long.
        drop((work, capacity));
        commits += 1;
        retention_step = StepResult::More;
        if commits.is_multiple_of(COMMITS_PER_RETENTION) {
            retention_step = run_retention_step(writer, context, &mut state.failed_deletions).await;
            match check_and_maintain(writer, context, state).await {
                // The next commit reports the damage.
                Ok(()) | Err(CommitError::Damaged(_)) => {}
                Err(error) => return ServeEnd::Failed(error),
            }
        }
    }
}

/// Checks that the file is still at its path; this check is needed also while nothing is stored. Stores the readings of
/// the clocks and the connections' statistics, and truncates SQLite's -wal file if it is too large.
///
/// # Errors
/// If the database has to be reopened, or is damaged.
async fn check_and_maintain(
    writer: &mut Writer,
    context: &TaskContext,
    state: &mut WriterState,
) -> Result<(), CommitError> {
    writer.check_file()?;
    ensure_undamaged(&context.integrity)?;
    let maintenance = async {
        writer.store_clock_readings(context.clock.stamp(), &mut state.incidents).await?;
        let connections = state.connections.observe(&context.snapshots.borrow(), context.clock.mono());
        if !connections.is_empty() {
            writer.store_connections(&connections).await?;
        }
        writer.limit_write_ahead_log(MAX_WAL_BYTES).await
    };
    maintenance.await.or_else(|error: CommitError| {
        // An error that leaves the connection usable, such as a full disk, is reported by the next commit.
        if error.leaves_connection_usable() { Ok(()) } else { Err(error) }
    })
}

/// Deletes a small part of the expired data. A failed deletion is retried in the next step.
async fn run_retention_step(
    writer: &mut Writer,
    context: &TaskContext,
    failed_deletions: &mut LogThrottle,
) -> StepResult {
    // Deletion writes to freed pages. In a damaged file freed pages must stay unchanged, because a repair may read rows
    // from them.
    if context.integrity.damage().is_some() {
        return StepResult::Done;
    }
    let now = context.clock.stamp();
    writer.retain(now).await.unwrap_or_else(|error| {
        context.integrity.record_if_damage(&error);
        if let Some(times) = failed_deletions.count_event(&error.to_string(), None, now.mono) {
            tracing::warn!(%error, times, "cannot delete expired data; the deletion is retried");
        }
        StepResult::Done
    })
}

/// Stores a group and retries while the database refuses it. Returns `false` if the task had to end before the group
/// was stored.
///
/// # Errors
/// If the database has to be reopened for the group.
async fn store(
    writer: &mut Writer,
    work: &[Work],
    context: &mut TaskContext,
    state: &mut WriterState,
) -> Result<bool, CommitError> {
    loop {
        let error = match commit(writer, work, context).await {
            Ok(committed) => {
                state.record_success(context.clock.stamp());
                set_readiness(&context.readiness, Readiness::Ready);
                for (head, reason) in &committed.quarantined {
                    tracing::error!(host = %head.host, number = head.number, %reason, "a batch was quarantined");
                }
                // The receiver is closed only while the aggregator ends.
                let _ended = context.store_events.send(StoreEvent::Committed(committed)).await;
                return Ok(true);
            }
            Err(error) => error,
        };
        if context.stop.is_cancelled() {
            tracing::error!(batches = work.len(), %error, "stopped before these batches could be stored; agents keep them");
            return Ok(false);
        }
        if !error.leaves_connection_usable() {
            return Err(error);
        }
        state.record_failure(&error, context.clock.stamp());
        set_readiness(&context.readiness, readiness_after(&error));
        // Requests are answered during the pause, too.
        let pause = tokio::time::sleep(state.backoff.next());
        tokio::pin!(pause);
        loop {
            tokio::select! {
                () = &mut pause => break,
                () = context.stop.cancelled() => break,
                Some(request) = context.requests.recv() => {
                    execute_request(writer, request, &context.integrity).await;
                }
            }
        }
    }
}

/// Commits a group once, unless the file is damaged.
async fn commit(
    writer: &mut Writer,
    work: &[Work],
    context: &TaskContext,
) -> Result<CommitResult, CommitError> {
    // This check comes before the check for damage, so that a file that replaced a damaged file is opened.
    writer.check_file()?;
    ensure_undamaged(&context.integrity)?;
    let committed = writer.commit(work, context.clock.stamp()).await;
    if let Err(CommitError::Database(error)) = &committed {
        context.integrity.record_if_damage(error);
    }
    // A group committed while damage was found is not acknowledged, so that the agents keep it.
    ensure_undamaged(&context.integrity)?;
    committed
}

/// Returns an error if damage of the file is known.
fn ensure_undamaged(integrity: &Integrity) -> Result<(), CommitError> {
    integrity.damage_message().map_or(Ok(()), |refusal| Err(CommitError::Damaged(refusal)))
}

/// Executes a request to the writer.
async fn execute_request(writer: &mut Writer, request: WriterRequest, integrity: &Integrity) {
    match request {
        WriterRequest::Pin(run, pinned, answer) => {
            let result = writer.pin(run, pinned, integrity).await;
            // The requester may have been dropped.
            let _gone = answer.send(result);
        }
    }
}

/// Returns the readiness after a group could not be stored.
fn readiness_after(error: &CommitError) -> Readiness {
    match error {
        CommitError::Damaged(damage) => {
            Readiness::NotStoring(format!("cannot store events: {damage}; agents keep them"))
        }
        error => not_storing(error),
    }
}

/// Returns the readiness while nothing can be stored.
pub(super) fn not_storing(error: &impl Display) -> Readiness {
    Readiness::NotStoring(format!("cannot store events: {error}; agents keep them, and storing is retried"))
}

/// Collects the group that begins with `first`: the work that is ready, and work that arrives until `first` has waited
/// for `grouping.interval` since its admission. Under load `first` has waited that long already during the previous
/// commit, so that the group waits no longer. A group of `grouping.min_nodes` nodes also waits no longer.
async fn collect_group(
    first: PreparedWork,
    queue: &mut mpsc::Receiver<PreparedWork>,
    waited: Duration,
    grouping: Grouping,
) -> Vec<PreparedWork> {
    let mut nodes = first.work.weight();
    let mut group = vec![first];
    let timeout = tokio::time::sleep(grouping.interval.saturating_sub(waited));
    tokio::pin!(timeout);
    while nodes < grouping.max_nodes {
        let next = if nodes >= grouping.min_nodes {
            queue.try_recv().ok()
        } else {
            tokio::select! {
                // Work that is ready joins the group even if `first` has waited long enough already.
                biased;
                next = queue.recv() => next,
                () = &mut timeout => None,
            }
        };
        let Some(next) = next else { break };
        nodes += next.work.weight();
        group.push(next);
    }
    group
}

/// Sets the readiness and logs each change once.
pub(super) fn set_readiness(readiness: &watch::Sender<Readiness>, current: Readiness) {
    readiness.send_if_modified(|previous| {
        if *previous == current {
            return false;
        }
        match &current {
            Readiness::Ready => tracing::info!("storing events again"),
            Readiness::NotStoring(reason) => tracing::warn!("{reason}"),
        }
        *previous = current;
        true
    });
}

#[cfg(test)]
mod tests;
