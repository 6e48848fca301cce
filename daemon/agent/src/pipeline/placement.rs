//! The placement of a pipeline: inference on this host, on a peer, or none.

use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use peernet_clock::{OneWayDelay, Span};
use peernet_inference::{FinishedJob, Job, LoadError, Pool};
use peernet_logger::{HostId, Recorder, Slug};
use peernet_networks::{
    AwaitedEvent, CloseReason, OpenError, RequestError, SESSION_VERSIONS, Session, SessionHello,
    SessionSettings,
};
use peernet_sample::Sample;
use peernet_stream::{Condition, FaultyHost, Outcome, Placement as PlacementDescription, PlacementKind};
use tokio::sync::{oneshot, watch};

use super::context::PipelineContext;
use super::local_requester::{CancelOnDrop, LocalRequester};
use crate::conditions::{InspectionSettings, inspect_host_in_time};
use crate::config::{ObserveConfig, PipelineConfig, PlacementConfig, RemoteConfig};
use crate::link::{LinkedSession, TransitStamps};
use crate::same_clock::ClockSocket;

/// An open placement: a loaded model, a session with a peer, or nothing.
#[derive(Debug)]
pub(super) enum Placement {
    Local(Arc<Pool>),
    Remote {
        session: Session,
        link: LinkedSession,
        config: Box<RemoteConfig>,
    },
    /// A sensor alone: samples get no answer.
    None,
}

/// Result for one sample.
pub(super) struct ComputationResult {
    /// The recorder with all stages up to the arrival of the answer.
    pub(super) log: Recorder,
    /// The answer (`None` from a sensor alone), or the outcome of an iteration without an answer.
    pub(super) result: Result<Option<Sample>, Outcome>,
    /// Sum of upload and download, from both hosts' monotonic clocks; `None` unless a peer answered.
    pub(super) transport: Option<Span>,
}

/// Reason why a placement could not be opened.
#[derive(Debug)]
pub(super) enum OpenFailure {
    /// The model of this host cannot be loaded. Only a change of the configuration helps.
    Model(LoadError),
    /// The server of a model of this host cannot be reached at present.
    ModelServerUnreachable(LoadError),
    /// The thread that loaded the model panicked.
    Panicked,
    /// The peer cannot be reached, or did not answer in time.
    Unreachable(OpenError),
    /// The peer refuses the session.
    Refused(OpenError),
}

impl Placement {
    /// Loads the model or opens a session with the peer.
    pub(super) async fn open(
        config: &PipelineConfig,
        context: &PipelineContext,
    ) -> Result<Self, OpenFailure> {
        match &config.placement {
            PlacementConfig::Local { model } => {
                let (bank, model) = (Arc::clone(&context.bank), model.clone());
                // This runs on a blocking thread, because a model may take minutes to load.
                let loading = tokio::task::spawn_blocking(move || bank.load(&model, None));
                let pool = loading.await.map_err(|_| OpenFailure::Panicked)?;
                pool.map(Self::Local).map_err(|error| match error.is_transient() {
                    true => OpenFailure::ModelServerUnreachable(error),
                    false => OpenFailure::Model(error),
                })
            }
            PlacementConfig::Remote(remote) => {
                // The pipeline itself limits the iterations in flight. With a lower limit in the session, iterations
                // would wait inside the session, where no stage records the wait.
                let pipeline_maximum = u32::try_from(config.max_in_flight.get()).unwrap_or(u32::MAX);
                let max_in_flight = remote.session.max_in_flight.max(pipeline_maximum);
                let settings = SessionSettings { max_in_flight, ..remote.session.clone() };
                Self::open_remote(remote, settings, &config.name, context).await
            }
            // A pipeline that observes has another loop (`observe`), which does not compute samples.
            PlacementConfig::None {} | PlacementConfig::Observe(_) => Ok(Self::None),
        }
    }

    /// Opens a session of a pipeline with the peer.
    pub(super) async fn open_remote(
        remote: &RemoteConfig,
        settings: SessionSettings,
        pipeline: &Slug,
        context: &PipelineContext,
    ) -> Result<Self, OpenFailure> {
        // Over this Unix socket, a cloud on this machine proves that both hosts read one clock. The socket is opened
        // before the hello with its name is sent, because the cloud connects to the socket before the cloud accepts the
        // session.
        let clock_socket = ClockSocket::listen(&*context.host.clock);
        let hello = SessionHello {
            versions: SESSION_VERSIONS,
            host: context.host.id,
            name: context.host.name.clone(),
            clock: context.host.clock.identity().clone(),
            pipeline: pipeline.clone(),
            model: remote.model.clone(),
            device: remote.device.clone(),
            clock_socket: clock_socket.as_ref().map(ClockSocket::name),
        };
        let clock = Arc::clone(&context.host.clock);
        let session = Session::open(&remote.peer, hello, settings, clock).await?;
        let link = context.links.attach(&session, &remote.peer, pipeline, clock_socket);
        // The first proof shows that both hosts read one clock. Without this wait the delays of the first iterations
        // would be judged before the proof.
        link.wait_for_first_proof().await;
        Ok(Self::Remote { session, link, config: Box::new(remote.clone()) })
    }

    /// Returns the judged delays, up and down, of messages that were observed here and at the peer; `None` without a
    /// peer.
    pub(super) fn judge_stamps(
        &self,
        up: &TransitStamps,
        down: Option<&TransitStamps>,
    ) -> [Option<OneWayDelay>; 2] {
        match self {
            Self::Local(_) | Self::None => [None, None],
            Self::Remote { link, .. } => link.judge_stamps(up, down),
        }
    }

    /// Requests an answer and waits for `timeout` at most.
    pub(super) async fn compute(
        &self,
        log: Recorder,
        sample: &Sample,
        timeout: Duration,
    ) -> ComputationResult {
        match self {
            Self::Local(pool) => compute_locally(pool, log, sample, timeout).await,
            Self::Remote { session, link, config } => {
                let mut completed = session.request(log, sample, timeout).await;
                // The delays are corrected now and not when the run is read, because live statistics show them.
                let transport = link.correct(&mut completed);
                let outcome = |error| match error {
                    RequestError::Timeout(awaited) => {
                        Outcome::Timeout(describe_timeout(awaited, config, link.name(), timeout))
                    }
                    error => outcome_from_error(error),
                };
                ComputationResult {
                    log: completed.recorder,
                    result: completed.result.map(Some).map_err(outcome),
                    transport,
                }
            }
            Self::None => ComputationResult { log, result: Ok(None), transport: None },
        }
    }

    /// Waits until the session with the peer ends, and returns the reason. Never returns without a peer.
    pub(super) async fn closed(&self) -> CloseReason {
        match self {
            Self::Local(_) | Self::None => std::future::pending().await,
            Self::Remote { session, .. } => session.closed().await,
        }
    }

    /// Closes the session with a goodbye. After the end of a run the goodbye contains `planned_iterations`, the number
    /// of iterations that the run should have.
    pub(super) async fn close(&self, planned_iterations: Option<u64>) {
        match (self, planned_iterations) {
            (Self::Remote { session, .. }, Some(planned_iterations)) => {
                session.close_after_run(planned_iterations).await;
            }
            (Self::Remote { session, .. }, None) => session.close().await,
            (Self::Local(_) | Self::None, _) => {}
        }
    }

    /// Returns the peer's id and name.
    pub(super) fn peer(&self) -> Option<(HostId, &Slug)> {
        match self {
            Self::Local(_) | Self::None => None,
            Self::Remote { session, .. } => Some((session.accepted().host, &session.accepted().name)),
        }
    }

    /// Returns a text about a limitation of the connection to the peer, if there is one.
    pub(super) fn caveat(&self) -> Option<&str> {
        match self {
            Self::Local(_) | Self::None => None,
            Self::Remote { session, .. } => session.caveat(),
        }
    }

    /// Returns the channel of remarks about the connection that are made while it is open.
    pub(super) fn remarks(&self) -> Option<watch::Receiver<Vec<String>>> {
        match self {
            Self::Local(_) | Self::None => None,
            Self::Remote { session, .. } => Some(session.remarks()),
        }
    }

    /// Returns facts about the model (label and text), and about the clock faults that are injected at the peer.
    pub(super) fn facts(&self) -> Vec<(String, String)> {
        match self {
            Self::Local(pool) => pool.facts(),
            Self::Remote { session, link, .. } => {
                let mut facts = session.accepted().facts.clone();
                if let Some(faults) = &session.accepted().host_clock.faults {
                    facts.push((FaultyHost::Cloud(link.name().as_str()).fact_name(), faults.to_string()));
                }
                facts
            }
            Self::None => Vec::new(),
        }
    }

    /// Inspects this host. Returns its conditions and the peer's conditions, which the peer reported when the session
    /// opened.
    ///
    /// `is_continuation` is `true` if the run directly continues another run. Starts of iterations, or observed
    /// messages, then become due during the inspection and wait for its end. The competing threads are therefore counted
    /// only once, so that the inspection does not sleep between several counts.
    pub(super) async fn conditions(
        &self,
        context: &PipelineContext,
        is_continuation: bool,
    ) -> Vec<Condition> {
        match self {
            Self::Remote { session, .. } => {
                conditions(Some(&session.accepted().conditions), context, is_continuation).await
            }
            Self::Local(_) | Self::None => conditions(None, context, is_continuation).await,
        }
    }

    /// Returns the conditions that the peer reported when the session opened.
    pub(super) fn peer_conditions(&self) -> &[Condition] {
        match self {
            Self::Remote { session, .. } => &session.accepted().conditions,
            Self::Local(_) | Self::None => &[],
        }
    }

    /// Returns the description for the store and the pages.
    pub(super) fn describe(&self) -> PlacementDescription {
        match self {
            Self::Local(pool) => PlacementDescription {
                kind: PlacementKind::Local,
                peer: None,
                network: None,
                address: None,
                model: pool.name().clone(),
                device: Some(pool.device()),
            },
            Self::Remote { session, config, .. } => PlacementDescription {
                peer: Some(session.accepted().name.clone()),
                model: session.accepted().model.clone(),
                device: Some(session.accepted().device.clone()),
                ..describe_remote(config)
            },
            Self::None => PlacementDescription::sensor_alone(),
        }
    }
}

/// Inspects this host, including its network if there is a peer. Returns its conditions and the peer's conditions.
pub(super) async fn conditions(
    peer: Option<&[Condition]>,
    context: &PipelineContext,
    is_continuation: bool,
) -> Vec<Condition> {
    let counting_rounds = if is_continuation { 1 } else { context.inspection.counting_rounds };
    let settings = InspectionSettings {
        network: peer.is_some(),
        counting_rounds,
        ..InspectionSettings::clone(&context.inspection)
    };
    let mut conditions = inspect_host_in_time(settings, context.host.name.to_string()).await;
    conditions.extend_from_slice(peer.unwrap_or_default());
    conditions
}

/// Returns the part of the description for the store and the pages that the configuration determines.
pub(crate) fn describe_planned(config: &PlacementConfig) -> PlacementDescription {
    match config {
        PlacementConfig::Local { model } => PlacementDescription {
            kind: PlacementKind::Local,
            peer: None,
            network: None,
            address: None,
            model: model.clone(),
            device: None,
        },
        PlacementConfig::Remote(config) => describe_remote(config),
        PlacementConfig::None {} => PlacementDescription::sensor_alone(),
        PlacementConfig::Observe(config) => describe_observed(config, None),
    }
}

/// Returns the description of an observed system. `peer` is the name of the other host whose agent observes the same
/// messages; `None` while the name is unknown.
pub(super) fn describe_observed(config: &ObserveConfig, peer: Option<Slug>) -> PlacementDescription {
    let Some(address) = &config.peer else { return PlacementDescription::observed() };
    PlacementDescription {
        kind: PlacementKind::Remote,
        peer,
        network: Some(address.network().name().to_owned()),
        address: Some(address.to_string()),
        ..PlacementDescription::observed()
    }
}

fn describe_remote(config: &RemoteConfig) -> PlacementDescription {
    PlacementDescription {
        kind: PlacementKind::Remote,
        peer: None,
        network: Some(config.peer.network().name().to_owned()),
        address: Some(config.peer.to_string()),
        model: config.model.clone().unwrap_or_else(Slug::any),
        device: config.device.clone(),
    }
}

/// Passes a sample to a model of this host, and waits for its answer for `timeout` at most.
async fn compute_locally(
    pool: &Pool,
    log: Recorder,
    sample: &Sample,
    timeout: Duration,
) -> ComputationResult {
    let (reply, mut done) = oneshot::channel();
    // The recorder moves to the model's thread. If the thread does not return the recorder, this copy has the nodes
    // that were recorded before. There are only a few nodes, so copying takes a fraction of a microsecond.
    let log_backup = log.clone();
    let received_at = log.clock().mono();
    let reply = Box::new(move |finished: FinishedJob| {
        // After a timeout the receiver no longer exists, so the send fails and the late answer is dropped.
        let _ = reply.send(finished);
    });
    let requester = Arc::<LocalRequester>::default();
    let _cancel = CancelOnDrop(Arc::clone(&requester));
    if let Err(refused) =
        pool.submit(Job { sample: sample.clone(), recorder: log, received_at, requester, reply })
    {
        let result = Err(Outcome::Failed(refused.reason.to_string()));
        return ComputationResult { log: refused.job.recorder, result, transport: None };
    }
    let answer = match futures::poll!(&mut done) {
        Poll::Ready(answer) => {
            if pool.runs_on_threads() {
                // Without yielding, an answer that is ready at the first poll would overtake the answers to older
                // samples, which are still queued.
                tokio::task::yield_now().await;
            }
            Ok(answer)
        }
        Poll::Pending => tokio::time::timeout(timeout, done).await,
    };
    match answer {
        Ok(Ok(FinishedJob { recorder: log, result })) => {
            let result = result.map(Some).map_err(|error| Outcome::Failed(error.to_string()));
            ComputationResult { log, result, transport: None }
        }
        Ok(Err(_)) => {
            let reason = format!("model {} dropped the sample without an answer", pool.name());
            ComputationResult { log: log_backup, result: Err(Outcome::Failed(reason)), transport: None }
        }
        Err(_) => {
            let within = timeout.as_millis();
            let advice = pool.blocked_for().map_or_else(
                || RAISE_TIMEOUT.to_owned(),
                |age| {
                    format!(
                        "it still computes an earlier request, which was cancelled and began {:.1} s ago; \
                         if this happens often, make samples smaller, or raise workers of the model",
                        age.seconds()
                    )
                },
            );
            let reason = format!("model {} gave no answer within {within} ms: {advice}", pool.name());
            ComputationResult { log: log_backup, result: Err(Outcome::Timeout(reason)), transport: None }
        }
    }
}

/// Advice after a timeout. The advice names an option, too, because the commands of the paper have no configuration
/// file.
const RAISE_TIMEOUT: &str =
    "if it needs longer, raise timeout_ms of the pipeline (or the option --timeout of peernet --client)";

/// Returns the reason of a timeout: what was waited for, for how long, and what to do.
fn describe_timeout(awaited: AwaitedEvent, config: &RemoteConfig, cloud: &Slug, timeout: Duration) -> String {
    let within = timeout.as_millis();
    let model = config.model.as_ref().map_or_else(String::new, |model| format!(" for model {model}"));
    match awaited {
        AwaitedEvent::Answer => {
            format!("no answer of cloud {cloud}{model} within {within} ms: {RAISE_TIMEOUT}")
        }
        AwaitedEvent::RestOfAnswer(partial_answers) => format!(
            "no complete answer of cloud {cloud}{model} within {within} ms, after partial answer {partial_answers}: {RAISE_TIMEOUT}"
        ),
        AwaitedEvent::Slot => format!(
            "nothing was sent to cloud {cloud}{model} within {within} ms, because earlier requests held all slots in flight: \
             lower the rate, or raise max_in_flight of the session"
        ),
    }
}

/// Returns the outcome of an iteration without an answer. A full queue of the model counts as a failure.
fn outcome_from_error(error: RequestError) -> Outcome {
    match error {
        RequestError::Lost(reason) => Outcome::Lost(reason),
        error @ RequestError::Timeout(_) => Outcome::Timeout(error.to_string()),
        error @ (RequestError::Failed(_) | RequestError::Overloaded(_)) => Outcome::Failed(error.to_string()),
    }
}

impl From<OpenError> for OpenFailure {
    fn from(error: OpenError) -> Self {
        match error {
            error @ (OpenError::Unreachable { .. }
            | OpenError::TimedOut { .. }
            | OpenError::Ended { .. }
            | OpenError::Unanswered { .. }) => Self::Unreachable(error),
            error @ (OpenError::Refused { .. } | OpenError::Incompatible { .. }) => Self::Refused(error),
        }
    }
}
