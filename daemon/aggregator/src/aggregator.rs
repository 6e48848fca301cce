//! Starting and stopping: checks, the tasks, and the handle that readers hold.

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
use crate::ingest::{self, Errand, Hosts, IngestSession, Reopening, committing, preparing, socket};
use crate::live::{self, Live, News};
use crate::picture::Picture;
use crate::readiness::Readiness;
use peernet_store::writing::{Integrity, OpenDatabase, Readers, StoredState};
use peernet_store::{OpenError, RetentionConfig, Store, StoreError};

/// News that wait for the live picture's task; it waits for nothing, so few are enough.
const NEWS: usize = 1_024;
/// Commits whose acknowledgements wait to be sent.
const COMMITS: usize = 16;
/// Errands that wait for the writer.
const ERRANDS: usize = 16;

/// The handle of a running aggregator: cheap to clone.
#[derive(Clone, Debug)]
pub struct Aggregator {
    live: watch::Receiver<Arc<Picture>>,
    ready: watch::Receiver<Readiness>,
    store: Store,
    errands: mpsc::Sender<Errand>,
    database: Arc<Path>,
    retention: RetentionConfig,
    rejections: Arc<RejectionCounts>,
}

/// A running aggregator.
#[derive(Debug)]
pub struct Running {
    /// For readers.
    pub handle: Aggregator,
    tasks: JoinSet<Result<(), Failure>>,
    names: HashMap<Id, &'static str>,
    stop: CancellationToken,
    /// The database, if it is open, when the writer's task has ended.
    written: oneshot::Receiver<Option<OpenDatabase>>,
}

impl Aggregator {
    /// Everything about a configuration that can be checked without starting.
    pub fn check(config: &AggregatorConfig) -> Vec<Problem> {
        config.problems()
    }

    /// Opens the database, listens, and starts the tasks; they end when `stop` is cancelled.
    ///
    /// # Errors
    /// When the configuration cannot work, the database cannot be opened or written, or the address is taken.
    pub async fn start(
        config: AggregatorConfig,
        clock: SharedClock,
        stop: CancellationToken,
    ) -> Result<Running, StartError> {
        if let Some(problem) = config.problems().into_iter().next() {
            return Err(problem.into());
        }
        let name = config.name();
        if let Some(folder) = config.database.parent() {
            let no_folder = |error| OpenError::no_folder(&config.database, error);
            std::fs::create_dir_all(folder).map_err(no_folder)?;
        }
        peernet_permissions::log_changes(&peernet_permissions::restrict_database(&config.database));
        let integrity = Integrity::of(&config.database);
        let (database, state) = OpenDatabase::open(&config.database, config.retention, &integrity).await?;
        let StoredState { streams, runs, unknown, hosts, known } = state;
        let (socket, address) = socket::listen(&config).await?;
        tracing::info!(%address, database = %config.database.display(), "the aggregator listens");

        let forget = Span::from_seconds(i64::try_from(config.forget_hosts_after_s).unwrap_or(i64::MAX));
        let mut picture = Live::new(name.clone(), address.clone(), forget);
        for (host, run, number) in runs {
            picture.take(News::Run(host, run, number), clock.stamp());
        }
        for (host, stored) in hosts {
            picture.take(News::Stored(host, stored, None), clock.stamp());
        }
        let (queue, waiting) = ingest::queue();
        let grouping = committing::Grouping::new(&config);
        // While one group is stored, the next is prepared.
        let (prepared, work) = preparing::ready(2 * grouping.most);
        let (errands_in, errands) = mpsc::channel(ERRANDS);
        let (news_in, news) = mpsc::channel(NEWS);
        let (stored_in, stored) = mpsc::channel(COMMITS);
        let (pictures, live) = watch::channel(picture.shared(clock.stamp()));
        let (written_in, written) = oneshot::channel();
        let (ready_in, ready) = watch::channel(Readiness::Ready);
        // What finds no room is asked for again, which costs more than waiting would.
        let (budget_bytes, most_window) = (ingest::ROOM_BYTES as u64, ingest::MOST_WINDOW);
        let challenges = Challenges::new(name.clone());
        let hosts = Hosts::new(config.max_hosts, known);
        let receiving =
            Receiving::new(ReceivingConfig { budget_bytes, most_window, ..ReceivingConfig::new(name) });
        let session = IngestSession::new(receiving, challenges, hosts, queue, streams, unknown);
        let store = Store::new(Readers::open(
            &config.database,
            config.readers,
            config.question_limit(),
            Arc::clone(&clock),
            integrity.clone(),
        ));

        let stop = stop.child_token();
        let mut running = Running {
            handle: Self {
                live,
                ready,
                store,
                errands: errands_in,
                database: config.database.as_path().into(),
                retention: config.retention,
                rejections: socket.rejections(),
            },
            tasks: JoinSet::new(),
            names: HashMap::new(),
            stop: stop.clone(),
            written,
        };
        running.spawn("live picture", {
            let clock = Arc::clone(&clock);
            async move {
                live::task::run(picture, news, pictures, clock).await;
                Ok(())
            }
        });
        running.spawn_thread("preparing", {
            let runtime = Handle::current();
            move || preparing::run(&runtime, waiting, &prepared)
        });
        let wires = committing::Wires {
            queue: work,
            errands,
            stored: stored_in,
            ready: ready_in,
            pictures: running.handle.live(),
            clock: Arc::clone(&clock),
            integrity: integrity.clone(),
            stop: stop.clone(),
        };
        let store = running.handle.store.clone();
        let reopening = Reopening { path: config.database, retention: config.retention, integrity, store };
        running.spawn("writer", async move {
            let database = Box::pin(committing::run(database, wires, grouping, reopening)).await;
            // Whoever does not join lets the connection drop.
            let _unjoined = written_in.send(database);
            Ok(())
        });
        let wires = socket::Wires { stored, news: news_in, clock, stop };
        running.spawn("ingest", socket::run(socket, address, session, wires));
        Ok(running)
    }

    /// Snapshots of the live picture: a new one when something changed, at most five per second.
    pub fn live(&self) -> watch::Receiver<Arc<Picture>> {
        self.live.clone()
    }

    /// What is stored.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Keeps a run whatever its age, or no longer. Returns whether there is a run of that number.
    ///
    /// # Errors
    /// When the database cannot be written now.
    pub async fn pin(&self, run: i64, pinned: bool) -> Result<bool, StoreError> {
        let (answer, answered) = oneshot::channel();
        match self.errands.send(Errand::Pin(run, pinned, answer)).await {
            Ok(()) => answered.await.unwrap_or_else(|_| Err(StoreError::no_writer())),
            Err(_) => Err(StoreError::no_writer()),
        }
    }

    /// How long what is stored is kept.
    pub const fn retention(&self) -> &RetentionConfig {
        &self.retention
    }

    /// Bytes of the database's files, with what is not yet in the main one; `None` while there is none.
    pub fn database_bytes(&self) -> Option<u64> {
        let mut log = self.database.as_os_str().to_owned();
        log.push("-wal");
        let main = std::fs::metadata(&self.database).ok()?.len();
        Some(main + std::fs::metadata(log).map_or(0, |log| log.len()))
    }

    /// Connections of the agents' port that were turned away or closed, by reason.
    pub fn rejections(&self) -> &RejectionCounts {
        &self.rejections
    }

    /// Whether events are being stored, to be followed.
    pub fn readiness(&self) -> watch::Receiver<Readiness> {
        self.ready.clone()
    }

    /// Whether events are being stored, and if not, why.
    pub fn ready(&self) -> Readiness {
        self.ready.borrow().clone()
    }
}

impl Running {
    fn spawn(
        &mut self,
        name: &'static str,
        task: impl Future<Output = Result<(), Failure>> + Send + 'static,
    ) {
        let id = self.tasks.spawn(task).id();
        self.names.insert(id, name);
    }

    /// A task that computes and never waits for long.
    fn spawn_thread(&mut self, name: &'static str, task: impl FnOnce() + Send + 'static) {
        let work = move || {
            task();
            Ok(())
        };
        let id = self.tasks.spawn_blocking(work).id();
        self.names.insert(id, name);
    }

    /// Waits until all tasks have ended: after `stop` was cancelled, or because one of them died. What was received
    /// by then is stored and acknowledged, unless the database refuses.
    ///
    /// # Errors
    /// When a task died or ended without being asked to; the others are ended then.
    pub async fn join(mut self) -> Result<(), Failure> {
        let mut first = Ok(());
        while let Some(ended) = self.tasks.join_next_with_id().await {
            let failure = match ended {
                Ok((_, Err(failure))) => Some(failure),
                Ok((id, Ok(()))) => {
                    // Cancelled before the tasks notice, which the token that it follows is not.
                    let unasked = !self.stop.is_cancelled() && first.is_ok();
                    unasked.then(|| Failure::TaskEnded(self.name(id)))
                }
                Err(error) => Some(Failure::TaskDied { task: self.name(error.id()), reason: words(error) }),
            };
            if let (Some(failure), Ok(())) = (failure, &first) {
                first = Err(failure);
                self.stop.cancel();
            }
        }
        self.close().await;
        first
    }

    /// Closes the database, the writing connection last: only that can carry SQLite's log over into the file, so that
    /// the file alone is whole.
    async fn close(&mut self) {
        self.handle.store.close().await;
        // The task that had it may have died, or its file is away.
        let Ok(Some(database)) = (&mut self.written).await else { return };
        if let (_, Err(error)) = database.close().await {
            tracing::warn!(%error, "the database was not closed well; what is stored is in its -wal file, too");
        }
    }

    fn name(&self, id: Id) -> &'static str {
        self.names.get(&id).copied().unwrap_or("unnamed")
    }
}

/// What a task said when it panicked.
fn words(error: JoinError) -> String {
    let Ok(panic) = error.try_into_panic() else { return "cancelled".to_owned() };
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without words").to_owned()
}
