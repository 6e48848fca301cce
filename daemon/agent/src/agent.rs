//! Starts and stops the agent.
//!
//! Start order: lock of the state directory, files in it, spool, event queue, threads, ports, then the tasks. Every
//! step that can fail precedes the first task. Stop order: pipelines, then serving, then the outbox.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{MonoTime, SharedClock};
use peernet_external::exec::FingerprintKey;
use peernet_inference::{Bank, LoadError, UnloadedModel};
use peernet_logger::Slug;
use peernet_networks::{Address, PeerClock};
use peernet_stream::{Event, HostDescription, HostMetrics, IncidentKind, LiveUpdate, PipelineState};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::argument_key::argument_key;
use crate::check::{Problem, check, remarks};
use crate::conditions::InspectionSettings;
use crate::config::{AgentConfig, PipelineConfig, StartMode};
use crate::error::StartError;
use crate::event_queue::{EventTap, MissedEventCounters};
use crate::host::{EventSinks, Host};
use crate::identity::{StateLock, host_id, host_secret};
use crate::incidents::{IncidentSubject, Incidents};
use crate::io::IoThreads;
use crate::link::{Cloud, LinkContext, Links, ProbeSettings};
use crate::live::{LiveStatistics, PipelineLiveState};
use crate::observed::ObservedPipelines;
use crate::outbox::{LiveSources, Outbox, OutboxContext};
use crate::pipeline::PipelineContext;
use crate::runs::Runs;
use crate::serve::{ServeContext, ServeEndpoints, ServedCounts};
use crate::tasks::{Failure, Tasks};
use crate::{host_clock, pipeline, serve, telemetry};

/// Namespace of the functions that check a configuration and start an agent. The type has no values.
#[derive(Debug)]
pub enum Agent {}

/// An agent that was started.
#[derive(Debug)]
pub struct RunningAgent {
    host: Host,
    bank: Arc<Bank>,
    live: LiveSources,
    serve_addresses: Vec<Address>,
    served_counts: watch::Receiver<ServedCounts>,
    missed_event_counters: MissedEventCounters,
    stoppable: StoppableParts,
}

/// The parts of an agent that [`RunningAgent::join`] stops.
#[derive(Debug)]
struct StoppableParts {
    tasks: Tasks,
    outbox: Option<Outbox>,
    io: IoThreads,
    stop_timeout: Duration,
    _state: StateLock,
}

impl Agent {
    /// Checks a configuration without starting an agent, and returns the problems that it finds in names, files,
    /// folders, models and ports. Blocks while it reads the files.
    pub fn check(config: &AgentConfig, clock: &SharedClock) -> Vec<Problem> {
        check(config, clock)
    }

    /// Returns remarks about settings that are valid but may surprise, such as a limit at which all iterations are
    /// warm-up. Blocks for some seconds if sensors and actuators query other hosts; `clock` measures the time limits of
    /// these queries.
    pub fn remarks(config: &AgentConfig, clock: &SharedClock) -> Vec<Problem> {
        remarks(config, clock)
    }

    /// Starts the agent: opens its ports and starts its pipelines. `version` is the program's version as shown to
    /// people. The agent runs until `stop` is cancelled; then [`RunningAgent::join`] completes the stop.
    ///
    /// # Errors
    /// [`StartError`] when the host's name, its state directory, spool, keys, threads or ports cannot be used. In this
    /// case nothing was started. A pipeline that cannot start is not an error: it is reported as failed, and the other
    /// pipelines run.
    pub async fn start(
        config: AgentConfig,
        version: &'static str,
        clock: SharedClock,
        stop: CancellationToken,
    ) -> Result<RunningAgent, StartError> {
        let (tap, results) = (None, None);
        start(config, version, clock, stop, tap, results).await
    }

    /// Starts the agent as [`start`](Self::start) does, for a program that runs it in the
    /// foreground. Each event also goes to `tap`, with or without an aggregator. Measuring does not
    /// wait for the program: events that do not fit into `tap` are dropped and counted
    /// ([`RunningAgent::missed_event_counters`]). `results` is the folder to which the program
    /// writes results, if any; its free space is one of the conditions of a run.
    ///
    /// # Errors
    /// Those of [`start`](Self::start).
    pub async fn start_with_tap(
        config: AgentConfig,
        version: &'static str,
        clock: SharedClock,
        stop: CancellationToken,
        tap: mpsc::Sender<Event>,
        results: Option<PathBuf>,
    ) -> Result<RunningAgent, StartError> {
        start(config, version, clock, stop, Some(EventTap::new(tap)), results).await
    }
}

/// Starts an agent; events also go to `tap`, if there is one. `results` is the folder to which the program writes
/// results, if any.
async fn start(
    config: AgentConfig,
    version: &'static str,
    clock: SharedClock,
    stop: CancellationToken,
    tap: Option<EventTap>,
    results: Option<PathBuf>,
) -> Result<RunningAgent, StartError> {
    let name = config.agent.host_name()?;
    // The directory is locked before anything is read: two agents with one state directory would have the same host id.
    let state = StateLock::acquire(&config.agent.state_dir)?;
    restrict_permissions(&config);
    // All files of the state directory are read before the first task starts, so that a failure leaves no task behind.
    let id = host_id(&config.agent.state_dir)?;
    let secret =
        config.agent.aggregator.as_ref().map(|_| host_secret(&config.agent.state_dir)).transpose()?;
    let fingerprint_key = argument_key(&config.agent.state_dir)?;
    let probes = ProbeSettings::read(&config.probes, &config.clock)?;
    let spool = crate::outbox::open_spool(&config, id, &clock).await?;
    let counter = spool.as_ref().map(|spool| spool.counter.clone()).unwrap_or_default();
    let (event_queue, receiver) = crate::event_queue::create(&config.agent, &clock, counter);
    let missed_event_counters = tap.as_ref().map(EventTap::missed_event_counters).unwrap_or_default();
    let event_queue = event_queue.with_tap(tap);
    let incidents = Incidents::new(Arc::clone(&clock), event_queue.clone());
    let bank = Arc::new(build_bank(&config, &clock, fingerprint_key.clone(), incidents.clone()));
    let (publish_clock, host_clock) = watch::channel(host_clock::initial_state(&clock));
    let link_context = LinkContext {
        name: name.clone(),
        clock: Arc::clone(&clock),
        host_clock: host_clock.clone(),
        event_queue: event_queue.clone(),
        incidents: incidents.clone(),
    };
    let links = Links::new(link_context, &config.clock, probes.clone());
    let inspection = Arc::new(InspectionSettings::from_config(&config, results));
    let host = Host { id, name, version, clock };
    let events = EventSinks { event_queue, incidents, runs: Runs::default() };
    let io = IoThreads::start(config.agent.io_threads).map_err(StartError::Threads)?;
    // The ports are opened within the runtime of the I/O threads, because a socket belongs to the runtime that opened
    // the socket.
    let endpoints = io.with_context(ServeEndpoints::open(&config, &probes, &host)).await?;
    let serve_addresses = endpoints.as_ref().map(ServeEndpoints::addresses).unwrap_or_default();
    for address in &serve_addresses {
        tracing::info!(%address, network = %address.network(), "serving models to peers");
    }

    // No step from here on can fail.
    let mut tasks = Tasks::new(&stop);
    let metrics = start_observing_host(
        &mut tasks,
        &config,
        &host,
        Arc::clone(&bank),
        events.incidents.clone(),
        publish_clock,
    );
    tasks.spawn_required_fallible(io.handle(), "links", links.clone().run(tasks.stop_token()));
    let pipelines = TaskTracker::new();
    let observed = ObservedPipelines::from_config(&config);
    let context = PipelineContext {
        host: host.clone(),
        events: events.clone(),
        bank: Arc::clone(&bank),
        links: links.clone(),
        observed: observed.clone(),
        fingerprint_key,
        inspection: Arc::clone(&inspection),
    };
    let live_statistics = start_pipelines(&mut tasks, io.handle(), &pipelines, &config, &context);
    let live = LiveSources { live_statistics, metrics, links, clock: host_clock.clone() };
    let (publish_counts, served_counts) = watch::channel(ServedCounts::default());
    if let Some(endpoints) = endpoints {
        let (host, incidents, bank) = (host.clone(), events.incidents.clone(), Arc::clone(&bank));
        let context = ServeContext { host, incidents, bank, observed, host_clock, inspection };
        start_serving(&mut tasks, io.handle(), pipelines, |pipelines_ended| {
            serve::run(endpoints, context, publish_counts, pipelines_ended)
        });
    }
    let outbox = match (receiver, spool, secret, &config.agent.aggregator) {
        (Some(receiver), Some(spool), Some(secret), Some(address)) => {
            let identity = (describe_host(&host, &bank, &serve_addresses), secret);
            let (clock, live) = (SharedClock::clone(&host.clock), live.clone());
            let context = OutboxContext { clock, incidents: events.incidents, runs: events.runs, live };
            let outbox = Outbox::start(&config, address.clone(), receiver, spool, identity, context);
            watch_outbox(&mut tasks, &outbox);
            Some(outbox)
        }
        // Without `[agent] aggregator` there is no receiver, no spool and no secret, and nothing is sent.
        _ => None,
    };
    tracing::info!(host = %host.name, id = %host.id, "the agent has started");
    let stop_timeout = config.agent.stop_timeout();
    let stoppable = StoppableParts { tasks, outbox, io, stop_timeout, _state: state };
    Ok(RunningAgent { host, bank, live, serve_addresses, served_counts, missed_event_counters, stoppable })
}

/// Starts the tasks that watch this host's clocks and its hardware. Returns the receiver of the hardware's metrics.
fn start_observing_host(
    tasks: &mut Tasks,
    config: &AgentConfig,
    host: &Host,
    bank: Arc<Bank>,
    incidents: Incidents,
    publish_clock: watch::Sender<PeerClock>,
) -> watch::Receiver<HostMetrics> {
    let runtime = Handle::current();
    let clock_monitor = host_clock::run(
        config.clock.clone(),
        config.clock_fault.clone(),
        Arc::clone(&host.clock),
        incidents,
        publish_clock,
        tasks.stop_token(),
    );
    tasks.spawn_required(&runtime, "host clock", clock_monitor);
    let (publish_metrics, metrics) = watch::channel(HostMetrics::default());
    tasks.spawn_required(
        &runtime,
        "telemetry",
        telemetry::run(Arc::clone(&host.clock), bank, publish_metrics, tasks.stop_token()),
    );
    metrics
}

/// Starts to serve peers on the runtime of the I/O threads, `io_runtime`. Serving stops only after this agent's
/// pipelines have ended.
fn start_serving<F, E>(
    tasks: &mut Tasks,
    io_runtime: &Handle,
    pipelines: TaskTracker,
    serve: impl FnOnce(CancellationToken) -> F,
) where
    F: Future<Output = Result<(), E>> + Send + 'static,
    E: std::error::Error + Send + Sync + 'static,
{
    // Pipelines end first, because a pipeline of this host may use a model that this host serves.
    let (stop, pipelines_ended) = (tasks.stop_token(), CancellationToken::new());
    let serving = serve(pipelines_ended.clone());
    tasks.spawn_required(&Handle::current(), "stop order", async move {
        stop.cancelled().await;
        pipelines.close();
        pipelines.wait().await;
        pipelines_ended.cancel();
    });
    tasks.spawn_required_fallible(io_runtime, "serve", serving);
}

/// Stops all tasks if the outbox ends unexpectedly. On a regular stop the outbox ends after the tasks.
fn watch_outbox(tasks: &mut Tasks, outbox: &Outbox) {
    let (ended, stop) = (outbox.ended(), tasks.stop_token());
    // A required task that ends before the stop makes `Tasks` stop all other tasks.
    tasks.spawn_required(&Handle::current(), "outbox", async move {
        let _ = stop.run_until_cancelled(ended.cancelled()).await;
    });
}

/// Restricts the permissions of the agent's files to owner and group. This includes files that earlier releases or
/// `peernet` created.
fn restrict_permissions(config: &AgentConfig) {
    let folder = &config.agent.state_dir;
    // Apart from the spool, the agent creates the other files in this folder for their owner only.
    let mut restricted_files = peernet_permissions::restrict_folder(folder, &["host-id", "lock"]);
    restricted_files.extend(peernet_permissions::restrict_database(&config.spool.path(folder)));
    peernet_permissions::log_changes(&restricted_files);
}

impl RunningAgent {
    /// Returns the host's name.
    pub const fn name(&self) -> &Slug {
        &self.host.name
    }

    /// Returns the description of the host for the aggregator. Reads the hardware of the host and the folders of
    /// models. This is too slow for calls once a second.
    pub fn description(&self) -> HostDescription {
        describe_host(&self.host, &self.bank, &self.serve_addresses)
    }

    /// Returns the addresses at which peers may ask for models, with the bound ports; empty without `[serve]`.
    pub fn serve_addresses(&self) -> &[Address] {
        &self.serve_addresses
    }

    /// Returns a receiver of the numbers of answers that were sent to peers.
    pub fn served_counts(&self) -> watch::Receiver<ServedCounts> {
        self.served_counts.clone()
    }

    /// Returns the cloud that serves a pipeline, or that served it last.
    pub fn serving_cloud(&self, pipeline: &Slug) -> Option<Cloud> {
        self.live.links.serving_cloud(pipeline)
    }

    /// Returns the time since which a pipeline waits for its sensor to be set up or to give a sample; `None` if it
    /// does not wait.
    pub fn sensor_busy_since(&self, pipeline: &Slug) -> Option<MonoTime> {
        self.live.live_statistics.sensor_busy_since(pipeline)
    }

    /// Starts to load one of this host's models, so that an error shows at once and the first peer does not wait for
    /// the model.
    pub fn load_model(&self, model: &Slug) -> JoinHandle<Result<(), LoadError>> {
        let (bank, model) = (Arc::clone(&self.bank), model.clone());
        tokio::task::spawn_blocking(move || {
            let default_device = None;
            bank.load(&model, default_device).map(drop)
        })
    }

    /// Returns the counters of events that did not fit into the tap of [`Agent::start_with_tap`].
    /// More events may be missed until [`join`](Self::join) returns.
    pub fn missed_event_counters(&self) -> MissedEventCounters {
        self.missed_event_counters.clone()
    }

    /// Returns the current live update. It contains every pipeline with the one-second summaries that the aggregator
    /// does not have yet, the links, the clock, the host's metrics and the counts of events.
    pub fn live_update(&self) -> LiveUpdate {
        let accounting = self.stoppable.outbox.as_ref().map(Outbox::accounting).unwrap_or_default();
        // Nothing is sent to the aggregator here, so nothing is marked as sent with the receipt.
        let (update, _receipt) = self.live.update(self.host.id, self.host.clock.wall(), accounting);
        update
    }

    /// Waits until the aggregator has stored all events of this host, until it has stored no event for `patience`, or
    /// until the outbox has ended.
    pub async fn wait_until_delivered(&self, patience: Duration) {
        if let Some(outbox) = &self.stoppable.outbox {
            outbox.wait_until_delivered(patience).await;
        }
    }

    /// Waits for the failure of a task, which also stops the agent. [`join`](Self::join) then returns the failure.
    pub async fn wait_for_failure(&mut self) {
        self.stoppable.tasks.wait_for_failure().await;
    }

    /// Waits until the token is cancelled or a task fails, then stops the agent within the configured time: pipelines
    /// finish the iterations in flight, runs end, and the outbox sends its events.
    ///
    /// # Errors
    /// When a task ended before it was stopped.
    pub async fn join(self) -> Result<(), Failure> {
        let Self { bank, stoppable, .. } = self;
        // The I/O threads and the lock of the state directory stay alive until this function returns.
        let StoppableParts { tasks, outbox, io: _io, stop_timeout, _state } = stoppable;
        let stop = tasks.stop_token();
        let stop_request = stop.clone();
        // The stop timeout counts from the request and includes the time that the tasks take to end.
        let requested_at = tokio::spawn(async move {
            stop_request.cancelled().await;
            Instant::now()
        });
        let tasks_result = tasks.join().await;
        stop.cancel();
        let now = Instant::now();
        let requested_at = requested_at.await.unwrap_or(now);
        // The outbox gets at least a quarter of the stop timeout, even if the tasks took longer than the other three
        // quarters to end.
        let deadline = (requested_at + stop_timeout).max(now + stop_timeout / 4);
        let close_outbox = async {
            match outbox {
                Some(outbox) => outbox.close(deadline).await,
                None => Ok(()),
            }
        };
        // Models are unloaded first, so that the outbox still sends the incidents that report the unloading. If this
        // takes longer than half of the remaining time, because a model is computing, the outbox is closed at the same
        // time: otherwise no time would be left to send events.
        let mut unloading = Box::pin(unload(bank, deadline - now));
        let unloaded = tokio::time::timeout((deadline - now) / 2, &mut unloading).await;
        let (outbox_result, unload_result) = match unloaded {
            Ok(unload_result) => (close_outbox.await, unload_result),
            Err(_) => tokio::join!(close_outbox, unloading),
        };
        // If the outbox ended unexpectedly, `tasks` returns an error, too. The result of the outbox comes first,
        // because only this result contains the reason. The error of `tasks` was logged.
        outbox_result.and(tasks_result).and(unload_result)
    }
}

/// Stops the threads of the models. A thread that computes or loads for longer than `timeout` is abandoned.
async fn unload(bank: Arc<Bank>, timeout: Duration) -> Result<(), Failure> {
    let unloading = tokio::task::spawn_blocking(move || bank.shutdown_within(timeout));
    let busy_models =
        unloading.await.map_err(|error| Failure { part: "models".to_owned(), cause: error.into() })?;
    for model in busy_models {
        tracing::warn!(%model, "the model was still loading or computing at the end of the stop timeout; its thread was abandoned");
    }
    Ok(())
}

/// Creates the bank of the configured models, which reports each loaded and each unloaded model as an incident.
fn build_bank(
    config: &AgentConfig,
    clock: &SharedClock,
    fingerprint_key: FingerprintKey,
    incidents: Incidents,
) -> Bank {
    let bank = Bank::new(config.models.clone(), config.onnxruntime.clone(), Arc::clone(clock));
    let bank = match serve::calibration_model(config) {
        Some(built_in) => bank.with_built_in(built_in),
        None => bank,
    };
    let unload_incidents = incidents.clone();
    let bank = bank.with_folders(config.bank.clone()).with_fingerprint_key(fingerprint_key);
    let bank = bank.on_load(move |pool| {
        let mut text =
            format!("loaded {} on {} in {:.2} s", pool.name(), pool.device(), pool.load_duration().seconds());
        if let Some(bytes) = pool.memory_growth() {
            text.push_str(&format!("; the process grew by {:.0} MB", bytes as f64 * 1e-6));
        }
        incidents.report(IncidentKind::ModelLoaded, IncidentSubject::default(), text);
    });
    bank.on_unload(move |model| {
        let UnloadedModel { name, device, loaded_for, reason, .. } = model;
        let mut text = format!(
            "unloaded {name} from {device}, where it was loaded for {:.2} s, {reason}",
            loaded_for.seconds()
        );
        if let Some(bytes) = model.memory_released {
            text.push_str(&format!("; the process shrank by {:.0} MB", bytes as f64 * 1e-6));
        }
        unload_incidents.report(IncidentKind::ModelUnloaded, IncidentSubject::default(), text);
    })
}

/// Starts the pipelines that start with the agent. Returns the live state of all pipelines.
fn start_pipelines(
    tasks: &mut Tasks,
    io_runtime: &Handle,
    tracker: &TaskTracker,
    config: &AgentConfig,
    context: &PipelineContext,
) -> LiveStatistics {
    // Half of the stop timeout is for the iterations in flight, the other half for sending their events.
    let drain_timeout = config.agent.stop_timeout() / 2;
    let start = |pipeline: &PipelineConfig| {
        let placement = pipeline::describe_planned(&pipeline.placement);
        let live_state =
            Arc::new(PipelineLiveState::new(pipeline.name.clone(), pipeline.load_text(), placement));
        match pipeline.start {
            StartMode::Boot => {
                let (config, shared_state) = (Arc::new(pipeline.clone()), Arc::clone(&live_state));
                let running =
                    pipeline::run(config, shared_state, context.clone(), tasks.stop_token(), drain_timeout);
                tasks.spawn_finite(
                    io_runtime,
                    &format!("pipeline {}", pipeline.name),
                    tracker.track_future(running),
                );
            }
            StartMode::Manual => {
                let reason = "not started: its configuration says start = \"manual\"";
                live_state.set_state(PipelineState::Waiting(reason.to_owned()));
            }
        }
        live_state
    };
    LiveStatistics::new(config.pipelines.iter().map(start).collect())
}

fn describe_host(host: &Host, bank: &Bank, serve_addresses: &[Address]) -> HostDescription {
    let addresses: Vec<String> = serve_addresses.iter().map(Address::to_string).collect();
    HostDescription {
        id: host.id,
        name: host.name.clone(),
        clock: host.clock.identity().clone(),
        version: host.version.to_owned(),
        hardware: telemetry::hardware(),
        serves: (!addresses.is_empty()).then(|| addresses.join(", ")),
        models: bank.offered_names(),
    }
}
