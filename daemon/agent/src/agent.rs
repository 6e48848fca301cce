//! Starting and stopping.

use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{MonoTime, SharedClock};
use peernet_external::exec::FingerprintKey;
use peernet_inference::{Bank, LoadError};
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
use crate::event_queue::EventTap;
use crate::host::{EventSinks, Host};
use crate::identity::{StateLock, host_id, host_secret};
use crate::incidents::{IncidentContext, Incidents};
use crate::io::IoThreads;
use crate::link::{Cloud, Links, Near, ProbeSettings};
use crate::live::{Display, LiveStatistics};
use crate::observed::ObservedPipelines;
use crate::outbox::{LiveSources, Outbox, Sources};
use crate::pipeline::PipelineContext;
use crate::runs::Runs;
use crate::serve::{ServeContext, ServeEndpoints, Served};
use crate::tasks::{Failure, Tasks};
use crate::{host_clock, pipeline, serve, telemetry};

/// The agent role of a host.
#[derive(Debug)]
pub enum Agent {}

/// An agent that has started.
#[derive(Debug)]
pub struct Running {
    host: Host,
    bank: Arc<Bank>,
    live: LiveSources,
    serves: Vec<Address>,
    served: watch::Receiver<Served>,
    tap: Option<EventTap>,
    parts: Parts,
}

/// What of an agent has an end.
#[derive(Debug)]
struct Parts {
    tasks: Tasks,
    outbox: Option<Outbox>,
    io: IoThreads,
    stop_timeout: Duration,
    _state: StateLock,
}

impl Agent {
    /// Everything that can be found wrong with a configuration without starting it: names, files, folders,
    /// models, the port. Blocks while it reads them.
    pub fn check(config: &AgentConfig, clock: &SharedClock) -> Vec<Problem> {
        check(config, clock)
    }

    /// What is not wrong, but may surprise, such as a limit that the warm-up uses up.
    pub fn remarks(config: &AgentConfig) -> Vec<Problem> {
        remarks(config)
    }

    /// Starts the agent of a program of this version, for people: takes its port, begins its pipelines. It runs until
    /// `stop` is cancelled; then [`Running::join`] sees it to its end.
    ///
    /// # Errors
    /// One of [`StartError`]: of the host's name, its state directory, spool, keys, threads or ports. Nothing was started
    /// then. A pipeline that cannot start is no error: it is reported, and the others run.
    pub async fn start(
        config: AgentConfig,
        version: &'static str,
        clock: SharedClock,
        stop: CancellationToken,
    ) -> Result<Running, StartError> {
        start(config, version, clock, stop, None).await
    }

    /// As [`start`](Self::start), for a program that runs an agent in the foreground: each event also goes to `tap`,
    /// with or without an aggregator. Measuring does not wait for the program: what does not fit is counted
    /// ([`Running::untapped`]).
    ///
    /// # Errors
    /// Those of [`start`](Self::start).
    pub async fn start_observed(
        config: AgentConfig,
        version: &'static str,
        clock: SharedClock,
        stop: CancellationToken,
        tap: mpsc::Sender<Event>,
    ) -> Result<Running, StartError> {
        start(config, version, clock, stop, Some(EventTap::new(tap))).await
    }
}

async fn start(
    config: AgentConfig,
    version: &'static str,
    clock: SharedClock,
    stop: CancellationToken,
    tap: Option<EventTap>,
) -> Result<Running, StartError> {
    let name = config.agent.host_name()?;
    let state = StateLock::take(&config.agent.state_dir)?;
    close_to_others(&config);
    // All that is read from the state directory is read before anything starts: what fails here leaves nothing half begun.
    let id = host_id(&config.agent.state_dir)?;
    let secret =
        config.agent.aggregator.as_ref().map(|_| host_secret(&config.agent.state_dir)).transpose()?;
    let fingerprints = argument_key(&config.agent.state_dir)?;
    let probes = ProbeSettings::read(&config.probes, &config.clock)?;
    let spool = crate::outbox::open_spool(&config, id, &clock).await?;
    let counter = spool.as_ref().map(|spool| spool.counter.clone()).unwrap_or_default();
    let (event_queue, exit) = crate::event_queue::entrance(&config.agent, &clock, counter);
    let event_queue = event_queue.tapped(tap.clone());
    let incidents = Incidents::new(Arc::clone(&clock), event_queue.clone());
    let bank = Arc::new(bank(&config, &clock, fingerprints.clone(), incidents.clone()));
    let (publish_clock, host_clock) = watch::channel(host_clock::not_asked_yet(&clock));
    let near = Near {
        name: name.clone(),
        clock: Arc::clone(&clock),
        own: host_clock.clone(),
        event_queue: event_queue.clone(),
        incidents: incidents.clone(),
    };
    let links = Links::new(near, &config.clock, probes.clone());
    let inspection = Arc::new(InspectionSettings::of(&config));
    let host = Host { id, name, version, clock };
    let events = EventSinks { event_queue, incidents, runs: Runs::default() };
    let io = IoThreads::start(config.agent.io_threads).map_err(StartError::Threads)?;
    let endpoints = io.within(ServeEndpoints::open(&config, &probes, &host)).await?;
    let serves = endpoints.as_ref().map(ServeEndpoints::addresses).unwrap_or_default();
    for address in &serves {
        tracing::info!(%address, network = %address.network(), "peers may ask for models");
    }

    // Nothing fails from here on.
    let mut tasks = Tasks::new(&stop);
    let metrics = start_observing_host(&mut tasks, &config, &host, events.incidents.clone(), publish_clock);
    tasks.keep_or_fail(io.handle(), "links", links.clone().run(tasks.stop()));
    let pipelines = TaskTracker::new();
    let observed = ObservedPipelines::of(&config);
    let context = PipelineContext {
        host: host.clone(),
        events: events.clone(),
        bank: Arc::clone(&bank),
        links: links.clone(),
        observed: observed.clone(),
        fingerprints,
        inspection: Arc::clone(&inspection),
    };
    let live_statistics = start_pipelines(&mut tasks, io.handle(), &pipelines, &config, &context);
    let live = LiveSources { live_statistics, metrics, links, clock: host_clock.clone() };
    let (count, served) = watch::channel(Served::default());
    if let Some(endpoints) = endpoints {
        let (host, incidents, bank) = (host.clone(), events.incidents.clone(), Arc::clone(&bank));
        let context = ServeContext { host, incidents, bank, observed, own: host_clock, inspection };
        start_serving(&mut tasks, io.handle(), pipelines, |ended| {
            serve::run(endpoints, context, count, ended)
        });
    }
    let outbox = match (exit, spool, secret, &config.agent.aggregator) {
        (Some(exit), Some(spool), Some(secret), Some(address)) => {
            let identity = (describe(&host, &bank, &serves), secret);
            let (clock, live) = (SharedClock::clone(&host.clock), live.clone());
            let sources = Sources { clock, incidents: events.incidents, runs: events.runs, live };
            let outbox = Outbox::start(&config, address.clone(), exit, spool, identity, sources);
            watch_outbox(&mut tasks, &outbox);
            Some(outbox)
        }
        _ => None,
    };
    tracing::info!(host = %host.name, id = %host.id, "the agent is up");
    let stop_timeout = config.agent.stop_timeout();
    let parts = Parts { tasks, outbox, io, stop_timeout, _state: state };
    Ok(Running { host, bank, live, serves, served, tap, parts })
}

/// Starts the tasks that watch this host's clocks and its hardware. Returns the figures of the hardware.
fn start_observing_host(
    tasks: &mut Tasks,
    config: &AgentConfig,
    host: &Host,
    incidents: Incidents,
    publish_clock: watch::Sender<PeerClock>,
) -> watch::Receiver<HostMetrics> {
    let runtime = Handle::current();
    let watching = host_clock::run(
        config.clock.clone(),
        config.rehearsal.clone(),
        Arc::clone(&host.clock),
        incidents,
        publish_clock,
        tasks.stop(),
    );
    tasks.keep(&runtime, "host clock", watching);
    let (publish, metrics) = watch::channel(HostMetrics::default());
    tasks.keep(&runtime, "telemetry", telemetry::run(Arc::clone(&host.clock), publish, tasks.stop()));
    metrics
}

/// Starts to serve peers on those threads, until the pipelines have ended: they may compute on this very host.
fn start_serving<F, E>(
    tasks: &mut Tasks,
    threads: &Handle,
    pipelines: TaskTracker,
    serve: impl FnOnce(CancellationToken) -> F,
) where
    F: Future<Output = Result<(), E>> + Send + 'static,
    E: std::error::Error + Send + Sync + 'static,
{
    let (stop, ended) = (tasks.stop(), CancellationToken::new());
    let serving = serve(ended.clone());
    tasks.keep(&Handle::current(), "order of stopping", async move {
        stop.cancelled().await;
        pipelines.close();
        pipelines.wait().await;
        ended.cancel();
    });
    tasks.keep_or_fail(threads, "serve", serving);
}

/// Ends the tasks when the outbox has ended. It outlives them when they are stopped.
fn watch_outbox(tasks: &mut Tasks, outbox: &Outbox) {
    let (ended, stop) = (outbox.ended(), tasks.stop());
    tasks.keep(&Handle::current(), "outbox", async move {
        let _ = stop.run_until_cancelled(ended.cancelled()).await;
    });
}

/// Takes away what others may do with the agent's files: those of earlier builds, and those that `peernet` just made.
fn close_to_others(config: &AgentConfig) {
    let folder = &config.agent.state_dir;
    let mut changed = peernet_permissions::restrict_folder(folder, &["host-id", "lock"]);
    changed.extend(peernet_permissions::restrict_database(&config.spool.path(folder)));
    peernet_permissions::log_changes(&changed);
}

impl Running {
    /// The host's name.
    pub const fn name(&self) -> &Slug {
        &self.host.name
    }

    /// What the host tells of itself. Reads its hardware and the folders of models: not for every second.
    pub fn description(&self) -> HostDescription {
        describe(&self.host, &self.bank, &self.serves)
    }

    /// Where peers may ask for models, with the real ports; empty where they may not.
    pub fn serves(&self) -> &[Address] {
        &self.serves
    }

    /// What peers were sent so far.
    pub fn served(&self) -> watch::Receiver<Served> {
        self.served.clone()
    }

    /// Who serves a pipeline, or served it last.
    pub fn served_by(&self, pipeline: &Slug) -> Option<Cloud> {
        self.live.links.served_by(pipeline)
    }

    /// Since when a pipeline waits for its sensor, to be set up or to give a sample; `None` when it does not.
    pub fn senses_since(&self, pipeline: &Slug) -> Option<MonoTime> {
        self.live.live_statistics.senses_since(pipeline)
    }

    /// Loads one of this host's models now: what is wrong with it shows at once, and its first peer does not wait for it.
    pub fn load(&self, model: &Slug) -> JoinHandle<Result<(), LoadError>> {
        let (bank, model) = (Arc::clone(&self.bank), model.clone());
        tokio::task::spawn_blocking(move || bank.load(&model, None).map(drop))
    }

    /// Events that did not fit into the tap of [`Agent::start_observed`].
    pub fn untapped(&self) -> u64 {
        self.tap.as_ref().map_or(0, EventTap::missed)
    }

    /// What the agent shows of itself now: every pipeline with the seconds that the aggregator has not seen
    /// yet, its links and its clock, the host's figures, the accounting of events.
    pub fn live(&self) -> LiveUpdate {
        let accounting = self.parts.outbox.as_ref().map(Outbox::accounting).unwrap_or_default();
        self.live.update(self.host.id, self.host.clock.wall(), accounting).0
    }

    /// Waits for the end: that of a task, which is a failure, or the token's. Then pipelines finish what is
    /// under way, runs end, the outbox hands over what it holds, all within the configured time.
    ///
    /// # Errors
    /// When a task ended that should not have.
    pub async fn join(self) -> Result<(), Failure> {
        let Self { bank, parts, .. } = self;
        let Parts { tasks, outbox, io: _io, stop_timeout, _state } = parts;
        let stop = tasks.stop();
        let told = stop.clone();
        let began = tokio::spawn(async move {
            told.cancelled().await;
            Instant::now()
        });
        let ended = tasks.join().await;
        stop.cancel();
        let now = Instant::now();
        let began = began.await.unwrap_or(now);
        // Whatever the iterations under way took, what they leave behind gets its time.
        let deadline = (began + stop_timeout).max(now + stop_timeout / 4);
        let stored = async {
            match outbox {
                Some(outbox) => outbox.close(deadline).await,
                None => Ok(()),
            }
        };
        let (stored, unloaded) = tokio::join!(stored, unload(bank, deadline - now));
        // That the outbox ended is a failure of the tasks, too; it alone says why. Theirs is in the log.
        stored.and(ended).and(unloaded)
    }
}

/// Ends the threads of the models; one that computes or loads for longer than `patience` is left to itself.
async fn unload(bank: Arc<Bank>, patience: Duration) -> Result<(), Failure> {
    let unloading = tokio::task::spawn_blocking(move || bank.shutdown_within(patience));
    let left = unloading.await.map_err(|error| Failure { part: "models".to_owned(), cause: error.into() })?;
    for model in left {
        tracing::warn!(%model, "not waited for: the model is still loading or computing");
    }
    Ok(())
}

fn bank(
    config: &AgentConfig,
    clock: &SharedClock,
    fingerprints: FingerprintKey,
    incidents: Incidents,
) -> Bank {
    let bank = Bank::new(config.models.clone(), config.onnxruntime.clone(), Arc::clone(clock));
    let bank = match serve::calibration(config) {
        Some(built_in) => bank.with_built_in(built_in),
        None => bank,
    };
    bank.with_folders(config.bank.clone()).with_fingerprints(fingerprints).on_load(move |pool| {
        let text =
            format!("loaded {} on {} in {:.2} s", pool.name(), pool.device(), pool.loaded_in().seconds());
        incidents.report(IncidentKind::ModelLoaded, IncidentContext::default(), text);
    })
}

fn start_pipelines(
    tasks: &mut Tasks,
    there: &Handle,
    tracker: &TaskTracker,
    config: &AgentConfig,
    context: &PipelineContext,
) -> LiveStatistics {
    // Half of the time to stop is for what is under way, the other half for handing it over.
    let patience = config.agent.stop_timeout() / 2;
    let start = |pipeline: &PipelineConfig| {
        let placement = pipeline::intended(&pipeline.placement);
        let display = Arc::new(Display::new(pipeline.name.clone(), pipeline.load_in_words(), placement));
        match pipeline.start {
            StartMode::Boot => {
                let (config, shown) = (Arc::new(pipeline.clone()), Arc::clone(&display));
                let running = pipeline::run(config, shown, context.clone(), tasks.stop(), patience);
                tasks.let_end(there, &format!("pipeline {}", pipeline.name), tracker.track_future(running));
            }
            StartMode::Manual => {
                let reason = "not started: its configuration says start = \"manual\"";
                display.set_state(PipelineState::Waiting(reason.to_owned()));
            }
        }
        display
    };
    LiveStatistics::new(config.pipelines.iter().map(start).collect())
}

fn describe(host: &Host, bank: &Bank, serves: &[Address]) -> HostDescription {
    let addresses: Vec<String> = serves.iter().map(Address::to_string).collect();
    HostDescription {
        id: host.id,
        name: host.name.clone(),
        clock: host.clock.identity().clone(),
        version: host.version.to_owned(),
        hardware: telemetry::hardware(),
        serves: (!addresses.is_empty()).then(|| addresses.join(", ")),
        models: bank.offered(),
    }
}
