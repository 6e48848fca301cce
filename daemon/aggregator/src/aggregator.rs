//! Start and stop of the aggregator: checks, the tasks, and the handle for readers.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use peernet_clock::{SharedClock, Span};
use peernet_networks::zmtp::RejectionCounts;
use peernet_stream::{Challenges, Receiving, ReceivingConfig};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::{Id, JoinError, JoinSet};
use tokio_util::sync::CancellationToken;

use crate::config::AggregatorConfig;
use crate::error::{Failure, Problem, StartError};
use crate::ingest::{self, Hosts, IngestSession, Reopening, WriterRequest, committing, preparing, socket};
use crate::live::{self, LiveEvent, LiveTracker};
use crate::live_state::LiveState;
use crate::readiness::Readiness;
use peernet_store::writing::{Integrity, OpenDatabase, Readers, StoredState};
use peernet_store::{OpenError, RetentionConfig, Store, StoreError};

/// Capacity of the channel of events to the live state's task. That task never waits, so a short channel is enough.
const LIVE_EVENT_CAPACITY: usize = 1_024;
/// Capacity of the channel of store events to the ingest task. Short, because that task never waits for the database.
const STORE_EVENT_CAPACITY: usize = 16;
/// Capacity of the channel of requests to the writer's task.
const WRITER_REQUEST_CAPACITY: usize = 16;

/// Handle of a running aggregator; cheap to clone.
#[derive(Clone, Debug)]
pub struct Aggregator {
    live: watch::Receiver<Arc<LiveState>>,
    readiness: watch::Receiver<Readiness>,
    store: Store,
    requests: mpsc::Sender<WriterRequest>,
    database: Arc<Path>,
    retention: RetentionConfig,
    rejections: Arc<RejectionCounts>,
}

/// A running aggregator. [`RunningAggregator::join`] waits for its end.
#[derive(Debug)]
pub struct RunningAggregator {
    /// Handle for readers.
    pub handle: Aggregator,
    tasks: JoinSet<Result<(), Failure>>,
    /// Names of the tasks, for [`Failure`].
    task_names: HashMap<Id, &'static str>,
    stop: CancellationToken,
    /// Receives the database, if it is open, when the writer's task ends.
    closed_database: oneshot::Receiver<Option<OpenDatabase>>,
}

impl Aggregator {
    /// Returns the problems of a configuration that are found without starting.
    pub fn check(config: &AggregatorConfig) -> Vec<Problem> {
        config.problems()
    }

    /// Opens the database, listens, and starts the tasks. The tasks end when `stop` is cancelled.
    ///
    /// # Errors
    /// If the configuration is invalid, the database cannot be opened or written, or the address is in use.
    pub async fn start(
        config: AggregatorConfig,
        clock: SharedClock,
        stop: CancellationToken,
    ) -> Result<RunningAggregator, StartError> {
        // Checked before anything is created, so that a wrong configuration leaves no files behind.
        if let Some(problem) = config.problems().into_iter().next() {
            return Err(problem.into());
        }
        let name = config.name();
        if let Some(folder) = config.database.parent() {
            let no_folder = |error| OpenError::folder_not_created(&config.database, error);
            std::fs::create_dir_all(folder).map_err(no_folder)?;
        }
        // Before the database is opened: files of earlier releases may be readable by other users.
        peernet_permissions::log_changes(&peernet_permissions::restrict_database(&config.database));
        let integrity = Integrity::new(&config.database);
        let (database, state) = OpenDatabase::open(&config.database, config.retention, &integrity).await?;
        let StoredState { streams, runs, runs_without_start, hosts, host_secrets } = state;
        let (socket, address) = socket::listen(&config).await?;
        tracing::info!(%address, database = %config.database.display(), "the aggregator listens");

        let host_timeout = Span::from_seconds(i64::try_from(config.forget_hosts_after_s).unwrap_or(i64::MAX));
        let mut tracker = LiveTracker::new(name.clone(), address.clone(), host_timeout);
        // The live state starts with what is stored, so that counts and run numbers are right from the first update on.
        for (host, run, number) in runs {
            tracker.apply(LiveEvent::Run(host, run, number), clock.stamp());
        }
        for (host, stored) in hosts {
            // The time of the host's newest stored event is unknown at the start.
            tracker.apply(LiveEvent::Stored(host, stored, None), clock.stamp());
        }
        let (queue, queued_items) = ingest::queue();
        let grouping = committing::Grouping::new(&config);
        // The channel has room for two groups: while one group is committed, the next group is prepared.
        let (prepared_work_sender, prepared_work) = preparing::channel(2 * grouping.max_nodes);
        let (request_sender, requests) = mpsc::channel(WRITER_REQUEST_CAPACITY);
        let (live_event_sender, live_events) = mpsc::channel(LIVE_EVENT_CAPACITY);
        let (store_event_sender, store_events) = mpsc::channel(STORE_EVENT_CAPACITY);
        let (snapshots, live) = watch::channel(tracker.shared_snapshot(clock.stamp()));
        let (closed_database_sender, closed_database) = oneshot::channel();
        let (readiness_sender, readiness) = watch::channel(Readiness::Ready);
        // A batch that does not fit into the queue has to be sent again, which costs more than waiting. The windows of
        // all agents therefore share the queue's capacity.
        let (budget_bytes, max_window) = (ingest::CAPACITY_BYTES as u64, ingest::MAX_WINDOW);
        let challenges = Challenges::new(name.clone());
        let hosts = Hosts::new(config.max_hosts, host_secrets);
        let receiving =
            Receiving::new(ReceivingConfig { budget_bytes, max_window, ..ReceivingConfig::new(name) });
        let session = IngestSession::new(receiving, challenges, hosts, queue, streams, runs_without_start);
        let store = Store::new(Readers::open(
            &config.database,
            config.readers,
            config.question_limit(),
            Arc::clone(&clock),
            integrity.clone(),
        ));

        // `stop` becomes a child token, because a failed task stops the other tasks and must not stop the rest of the
        // program.
        let stop = stop.child_token();
        let mut running = RunningAggregator {
            handle: Self {
                live,
                readiness,
                store,
                requests: request_sender,
                database: config.database.as_path().into(),
                retention: config.retention,
                rejections: socket.rejections(),
            },
            tasks: JoinSet::new(),
            task_names: HashMap::new(),
            stop: stop.clone(),
            closed_database,
        };
        running.spawn("live state", {
            let clock = Arc::clone(&clock);
            async move {
                live::task::run(tracker, live_events, snapshots, clock).await;
                Ok(())
            }
        });
        running.spawn_thread("preparing", {
            let runtime = Handle::current();
            move || preparing::run(&runtime, queued_items, &prepared_work_sender)
        });
        let context = committing::TaskContext {
            queue: prepared_work,
            requests,
            store_events: store_event_sender,
            readiness: readiness_sender,
            snapshots: running.handle.live(),
            clock: Arc::clone(&clock),
            integrity: integrity.clone(),
            stop: stop.clone(),
        };
        let store = running.handle.store.clone();
        let reopening = Reopening { path: config.database, retention: config.retention, integrity, store };
        running.spawn("writer", async move {
            let database = Box::pin(committing::run(database, context, grouping, reopening)).await;
            // If nobody calls `join`, the receiver is gone and the connection is dropped.
            let _unjoined = closed_database_sender.send(database);
            Ok(())
        });
        let context = socket::TaskContext { store_events, live_events: live_event_sender, clock, stop };
        running.spawn("ingest", socket::run(socket, address, session, context));
        Ok(running)
    }

    /// Returns a receiver of the snapshots of the live state. There is a new snapshot after each change, but at most
    /// five per second.
    pub fn live(&self) -> watch::Receiver<Arc<LiveState>> {
        self.live.clone()
    }

    /// Returns the store, for queries.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Protects a run from the retention limits, or ends that protection. Returns whether there is a run with
    /// that number.
    ///
    /// # Errors
    /// If the database cannot be written now.
    pub async fn pin(&self, run: i64, pinned: bool) -> Result<bool, StoreError> {
        let (answer_sender, answer) = oneshot::channel();
        match self.requests.send(WriterRequest::Pin(run, pinned, answer_sender)).await {
            Ok(()) => answer.await.unwrap_or_else(|_| Err(StoreError::pin_without_writer())),
            Err(_) => Err(StoreError::pin_without_writer()),
        }
    }

    /// Returns the retention limits of the configuration.
    pub const fn retention(&self) -> &RetentionConfig {
        &self.retention
    }

    /// Returns the size of the database's file and of its -wal file together, bytes; `None` if there is no database
    /// file.
    pub fn database_bytes(&self) -> Option<u64> {
        let mut wal_path = self.database.as_os_str().to_owned();
        wal_path.push("-wal");
        let main_bytes = std::fs::metadata(&self.database).ok()?.len();
        Some(main_bytes + std::fs::metadata(wal_path).map_or(0, |wal| wal.len()))
    }

    /// Returns the numbers of connections of the agents' port that were rejected or closed, by reason.
    pub fn rejections(&self) -> &RejectionCounts {
        &self.rejections
    }

    /// Returns a receiver that states whether events are being stored.
    pub fn readiness(&self) -> watch::Receiver<Readiness> {
        self.readiness.clone()
    }

    /// Returns whether events are being stored, and the reason if not.
    pub fn current_readiness(&self) -> Readiness {
        self.readiness.borrow().clone()
    }
}

impl RunningAggregator {
    /// Spawns a task that ends with the aggregator.
    fn spawn(
        &mut self,
        name: &'static str,
        task: impl Future<Output = Result<(), Failure>> + Send + 'static,
    ) {
        let id = self.tasks.spawn(task).id();
        self.task_names.insert(id, name);
    }

    /// Spawns a task on a separate thread, where it may compute and wait. Such a thread cannot be aborted: the task must
    /// end when its input is closed.
    fn spawn_thread(&mut self, name: &'static str, task: impl FnOnce() + Send + 'static) {
        let work = move || {
            task();
            Ok(())
        };
        let id = self.tasks.spawn_blocking(work).id();
        self.task_names.insert(id, name);
    }

    /// Waits until all tasks have ended: after `stop` was cancelled, or because a task died. Events that were received
    /// before the end are stored and acknowledged, unless the database refuses them.
    ///
    /// # Errors
    /// If a task died or ended although `stop` was not cancelled; the other tasks are stopped then.
    pub async fn join(mut self) -> Result<(), Failure> {
        let mut result = Ok(());
        while let Some(ended) = self.tasks.join_next_with_id().await {
            let failure = match ended {
                Ok((_, Err(failure))) => Some(failure),
                Ok((id, Ok(()))) => {
                    // The end of a task is expected after `stop` was cancelled, and after another task failed.
                    let is_unexpected = !self.stop.is_cancelled() && result.is_ok();
                    is_unexpected.then(|| Failure::TaskEnded(self.name(id)))
                }
                Err(error) => {
                    Some(Failure::TaskDied { task: self.name(error.id()), reason: panic_message(error) })
                }
            };
            // Only the first failure is reported, because it causes the other failures.
            if let (Some(failure), Ok(())) = (failure, &result) {
                result = Err(failure);
                self.stop.cancel();
            }
        }
        self.close().await;
        result
    }

    /// Closes the database. The writing connection is closed last: only the last connection checkpoints the -wal file,
    /// after which the database file is complete without it.
    async fn close(&mut self) {
        self.handle.store.close().await;
        // There is no database if the writer's task died or the file is missing.
        let Ok(Some(database)) = (&mut self.closed_database).await else { return };
        if let (_, Err(error)) = database.close().await {
            tracing::warn!(%error, "cannot close the database cleanly; keep its -wal file, which contains a part of the stored data");
        }
    }

    /// Returns the name of a task.
    fn name(&self, id: Id) -> &'static str {
        self.task_names.get(&id).copied().unwrap_or("unnamed")
    }
}

/// Returns the message of a task's panic.
fn panic_message(error: JoinError) -> String {
    let Ok(panic) = error.try_into_panic() else { return "cancelled".to_owned() };
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without a message").to_owned()
}
