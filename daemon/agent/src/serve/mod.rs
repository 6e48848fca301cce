//! Serving: sessions of peers that use this host's models.
//!
//! A request goes to the pool of its session's model, whose worker records `queue`, `preprocessing`, `inference` and
//! `postprocessing`. The answer carries only the nodes that this host added to the tree. Sessions that ask for
//! `observed-stamps` get the stamps of observed messages instead of a model.

mod endpoints;
mod listeners;
mod reflector;
mod request_counts;
mod served;
mod service;

pub(crate) use endpoints::{ServeEndpoints, calibration_model};
pub use served::ServedCounts;

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use peernet_inference::{Bank, FinishedJob, InferenceError};
use peernet_logger::{HostId, Slug};
use peernet_networks::{
    Address, Announcer, Failure, Incoming, IncomingRequest, Listener, MAX_CONDITIONS, OpenRequest, PeerClock,
    ProbeKey, SessionAccepted, SessionId,
};
use peernet_probes::{ReceiveError, Reflector};
use peernet_stream::{Condition, Hardware, IncidentKind};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use self::listeners::Listeners;
use self::request_counts::RequestCounts;
use self::service::{Refusal, Service};
use crate::conditions::InspectionSettings;
use crate::host::Host;
use crate::incidents::{IncidentSubject, Incidents, remark};
use crate::observed::ObservedPipelines;
use crate::same_clock::ClockResponder;
use crate::telemetry;

/// The parts of the agent that serving uses.
#[derive(Clone, Debug)]
pub(crate) struct ServeContext {
    pub(crate) host: Host,
    pub(crate) incidents: Incidents,
    /// Models that are served.
    pub(crate) bank: Arc<Bank>,
    /// Stamps of the messages that this host's pipelines observe, which peers may query.
    pub(crate) observed: ObservedPipelines,
    /// State of this host's clocks.
    pub(crate) host_clock: watch::Receiver<PeerClock>,
    /// Settings of the inspection of this host's conditions.
    pub(crate) inspection: Arc<InspectionSettings>,
}

/// Reason why serving ended before the agent was stopped.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ServeError {
    /// The port for sessions was lost.
    #[error("the listening socket at {0} was lost")]
    PortLost(Address),
    /// The port for probes was lost.
    #[error(transparent)]
    Reflector(#[from] ReceiveError),
}

/// Serves on all ports until `stop` is cancelled, and counts the answers.
pub(crate) async fn run(
    endpoints: ServeEndpoints,
    context: ServeContext,
    served: watch::Sender<ServedCounts>,
    stop: CancellationToken,
) -> Result<(), ServeError> {
    let serve_identity = ServeIdentity {
        probe_ports: endpoints.probe_ports,
        instance: endpoints.instance,
        probe_key: endpoints.probe_key,
        built_in: endpoints.built_in,
    };
    let host_clock = context.host_clock.clone();
    let (served, hardware) = (Arc::new(served), telemetry::hardware());
    for listener in &endpoints.listeners {
        if let Some(caveat) = listener.caveat() {
            remark(&format!("{}: {caveat}", listener.address()));
        }
    }
    let caveats = endpoints.listeners.iter().map(|listener| listener.caveat().map(str::to_owned)).collect();
    let server = Server {
        context,
        serve_identity,
        hardware,
        served,
        peers: HashMap::new(),
        allowed_probers: endpoints.reflectors.iter().map(Reflector::peers).collect(),
        request_counts: RequestCounts::default(),
        caveats,
    };
    let announcers = endpoints.listeners.iter().map(Listener::announcer).collect();
    let announcing = async {
        announce_clock_and_statistics(host_clock, announcers, stop.clone()).await;
        Ok(())
    };
    let reflectors = endpoints.reflectors.into_iter().map(|reflector| reflector.run(stop.clone()));
    let reflecting = async {
        futures::future::try_join_all(reflectors).await?;
        Ok(())
    };
    let serving = serve_sessions(Listeners::new(endpoints.listeners), server, stop.clone());
    let ((), (), ()) = tokio::try_join!(serving, reflecting, announcing)?;
    Ok(())
}

/// Interval at which the statistics of this end of each connection are sent.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// Sends changes of this host's clocks to all peers at once, and the statistics of each connection periodically.
async fn announce_clock_and_statistics(
    mut host_clock: watch::Receiver<PeerClock>,
    announcers: Vec<Announcer>,
    stop: CancellationToken,
) {
    let announcing = async {
        while host_clock.changed().await.is_ok() {
            let clock = host_clock.borrow_and_update().clone();
            for announcer in &announcers {
                announcer.announce(clock.clone());
            }
        }
    };
    let reporting = async {
        let mut report_interval = tokio::time::interval(REPORT_INTERVAL);
        report_interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            report_interval.tick().await;
            let announcers = announcers.clone();
            // This runs on a blocking thread: the report makes a system call for each connection, which must not delay
            // sessions.
            let report = move || announcers.iter().for_each(Announcer::report_statistics);
            if let Err(error) = tokio::task::spawn_blocking(report).await {
                tracing::error!(%error, "the report of connection statistics to peers panicked; no more reports are sent");
                return;
            }
        }
    };
    stop.run_until_cancelled(async { tokio::join!(announcing, reporting) }).await;
}

/// Serves sessions until `stop` is cancelled.
async fn serve_sessions(
    mut listeners: Listeners,
    mut server: Server,
    stop: CancellationToken,
) -> Result<(), ServeError> {
    // Models that are being loaded for a peer. Each listener bounds the number of its peers, so the number of
    // these models is bounded, too.
    let mut loading: JoinSet<PreparedSession> = JoinSet::new();
    let mut stopping = std::pin::pin!(stop.cancelled());
    loop {
        tokio::select! {
            // Messages come last, because they may follow each other without a pause.
            biased;
            () = &mut stopping => break,
            Some(loaded) = loading.join_next() => match loaded {
                Ok(loaded) => server.answer(loaded),
                // The panic dropped the request, and dropping a request refuses its session.
                Err(error) => tracing::error!(%error, "loading a model for a peer panicked"),
            },
            (listener, incoming) = listeners.next() => match incoming {
                Some(Incoming::Request(request)) => server.compute(request),
                Some(Incoming::Open(request)) => {
                    let context = server.context.clone();
                    // This runs on a blocking thread: a model may load for minutes, and other peers are served
                    // meanwhile.
                    loading.spawn_blocking(move || prepare(request, listener, &context));
                }
                Some(Incoming::Closed { session, said_goodbye, planned_iterations }) => {
                    server.handle_session_end(session, said_goodbye, planned_iterations);
                }
                Some(Incoming::Remark { session, text }) => server.remark(session, &text),
                Some(Incoming::Refused { host, text }) => {
                    let subject = IncidentSubject { peer: host, ..IncidentSubject::default() };
                    server.context.incidents.remark(IncidentKind::Refused, subject, text);
                }
                None => return Err(ServeError::PortLost(listeners.address(listener).clone())),
            },
        }
    }
    listeners.close().await;
    Ok(())
}

/// Prepares a session that a peer requests. Blocks while a model loads.
fn prepare(request: OpenRequest, listener: usize, context: &ServeContext) -> PreparedSession {
    // The host is inspected first, because loading a model would count as competing load.
    let conditions = inspect_conditions(context);
    let service = Service::prepare(&request.hello, context);
    PreparedSession { request, listener, service, conditions }
}

/// Inspects this host, and returns the conditions that are sent to the peer when its session opens.
fn inspect_conditions(context: &ServeContext) -> Vec<Condition> {
    let mut conditions = crate::conditions::inspect_host(&context.inspection, context.host.name.as_str());
    conditions.truncate(MAX_CONDITIONS);
    conditions
}

/// Values of this process that its sessions need.
#[derive(Clone, Debug)]
struct ServeIdentity {
    /// Ports for probes, one for each listener.
    probe_ports: Vec<Option<u16>>,
    /// Random number of this process, which answers the probes.
    instance: u64,
    /// Key that authenticates probes if none is configured.
    probe_key: Option<ProbeKey>,
    /// Built-in model for calibrations, whose answers are not counted as served.
    built_in: Option<Slug>,
}

/// A request for a session, with the service that was prepared for it.
struct PreparedSession {
    request: OpenRequest,
    /// Index of the listener at which the request arrived.
    listener: usize,
    service: Result<Service, Refusal>,
    conditions: Vec<Condition>,
}

/// A peer with a session.
struct Peer {
    host: HostId,
    name: Slug,
    pipeline: Slug,
    /// IP address from which the peer has connected. The peer sends its probes from the same address.
    address: Option<IpAddr>,
    service: Service,
    /// Counter of the run's requests, and counts of all answers; `None` if this session is not counted.
    counters: Option<(Arc<AtomicU64>, Arc<watch::Sender<ServedCounts>>)>,
    /// Task that proves to the peer that both processes read one clock, if they do. Dropping this handle ends the task.
    _responder: Option<AbortOnDropHandle<()>>,
}

/// The sessions of this host's peers, and what serving them needs.
struct Server {
    context: ServeContext,
    serve_identity: ServeIdentity,
    /// Hardware of this host.
    hardware: Hardware,
    served: Arc<watch::Sender<ServedCounts>>,
    peers: HashMap<SessionId, Peer>,
    /// Channels that give each reflector the addresses of the peers with a session.
    allowed_probers: Vec<watch::Sender<Vec<IpAddr>>>,
    request_counts: RequestCounts,
    /// Caveat about the connections of each listener, if there is one.
    caveats: Vec<Option<String>>,
}

impl Server {
    /// Accepts or refuses a session.
    fn answer(&mut self, PreparedSession { request, listener, service, conditions }: PreparedSession) {
        let hello = &request.hello;
        let (host, name, pipeline) = (hello.host, hello.name.clone(), hello.pipeline.clone());
        match service {
            Ok(service) => {
                let caveat = self.caveats.get(listener).and_then(Option::as_ref);
                let caveat = caveat.map(|caveat| format!("; {caveat}")).unwrap_or_default();
                let text = format!(
                    "{name} opened a session for its pipeline {pipeline} with {}{caveat}",
                    service.name()
                );
                let (session, accepted) = (request.session, self.acceptance(listener, &service, conditions));
                let address = request.address.map(|address| address.ip());
                // The responder connects before the session is accepted, because the edge closes its socket after the
                // acceptance.
                let responder = ClockResponder::connect(hello, session, &self.context.host.clock);
                let responder =
                    responder.map(|responder| AbortOnDropHandle::new(tokio::spawn(responder.answer())));
                // The reflectors are updated before the session is accepted, because the peer may send probes as soon
                // as it has the acceptance.
                self.update_reflectors(address);
                if request.accept(accepted) {
                    let is_counted = match &service {
                        Service::Model(pool) => self.serve_identity.built_in.as_ref() != Some(pool.name()),
                        Service::Stamps(..) => false,
                    };
                    let counters = is_counted
                        .then(|| (self.request_counts.counter(host, &pipeline), Arc::clone(&self.served)));
                    let peer =
                        Peer { host, name, pipeline, address, service, counters, _responder: responder };
                    self.peers.insert(session, peer);
                    self.served.send_modify(|served| served.sessions = self.peers.len());
                    self.report(IncidentKind::Connected, host, text);
                } else {
                    // The edge has disconnected in the meantime, so its address is removed again.
                    self.update_reflectors(None);
                }
            }
            Err(Refusal { reason, to_peer }) => {
                let text = format!("refused a session to pipeline {pipeline} of {name}: {reason}");
                request.refuse(to_peer);
                self.report(IncidentKind::Refused, host, text);
            }
        }
    }

    /// Sends the reflectors the addresses of the peers with a session, and `opening`, the address of a session being
    /// opened.
    fn update_reflectors(&self, opening: Option<IpAddr>) {
        for allowed in &self.allowed_probers {
            let open_addresses = self.peers.values().filter_map(|peer| peer.address);
            allowed.send_replace(open_addresses.chain(opening).collect());
        }
    }

    /// Returns the message with which a session is accepted.
    fn acceptance(&self, listener: usize, service: &Service, conditions: Vec<Condition>) -> SessionAccepted {
        SessionAccepted {
            host: self.context.host.id,
            name: self.context.host.name.clone(),
            clock: self.context.host.clock.identity().clone(),
            version: self.context.host.version.to_owned(),
            model: service.name(),
            device: service.device(),
            facts: service.facts(),
            host_clock: self.context.host_clock.borrow().clone(),
            probes: self.serve_identity.probe_ports.get(listener).copied().flatten(),
            instance: self.serve_identity.instance,
            probe_key: self.serve_identity.probe_key,
            conditions,
            hardware: self.hardware.clone(),
        }
    }

    /// Passes a request to its service, which sends the answer.
    fn compute(&self, request: IncomingRequest) {
        let Some(peer) = self.peers.get(&request.session) else {
            let IncomingRequest { recorder, reply, .. } = request;
            reply.send(recorder, Err(Failure::Failed("the session is not open".to_owned())));
            return;
        };
        let served = peer.counters.as_ref().map(|(requests, served)| {
            // Only this task reads and writes the counter, so it needs no stronger ordering.
            requests.fetch_add(1, Ordering::Relaxed);
            Arc::clone(served)
        });
        peer.service.answer(request, move |FinishedJob { recorder, result }: &FinishedJob| {
            if let Some(served) = served {
                let inference =
                    result.as_ref().ok().and_then(|_| served::inference_duration(recorder.tree()));
                served.send_modify(|served| served.add(result.is_err(), inference));
            }
        });
    }

    /// Handles the end of a session. Only an end without a goodbye is an incident.
    fn handle_session_end(
        &mut self,
        session: SessionId,
        said_goodbye: bool,
        planned_iterations: Option<u64>,
    ) {
        // A session that was never accepted is not in the map.
        let Some(Peer { host, name, pipeline, counters, .. }) = self.peers.remove(&session) else { return };
        self.update_reflectors(None);
        // After a lost connection, the run may continue in another session. Missed requests are counted at the goodbye.
        let is_counted_goodbye = said_goodbye && counters.is_some();
        let missed = if is_counted_goodbye {
            self.request_counts.take_missed(host, &pipeline, planned_iterations)
        } else {
            0
        };
        self.served.send_modify(|served| {
            served.sessions = self.peers.len();
            served.missed = served.missed.saturating_add(missed);
        });
        if said_goodbye {
            tracing::info!("{name} closed the session for its pipeline {pipeline}");
        } else {
            let text = format!(
                "lost the connection to {name}: the session for its pipeline {pipeline} ended without a goodbye"
            );
            self.report(IncidentKind::Disconnected, host, text);
        }
    }

    /// Reports a caveat of a connection, with the name of the peer whose session uses the connection.
    fn remark(&self, session: Option<SessionId>, text: &str) {
        let peer = session.and_then(|session| self.peers.get(&session));
        let prefix =
            peer.map(|peer| format!("session of {} for its pipeline {}: ", peer.name, peer.pipeline));
        let subject = IncidentSubject { peer: peer.map(|peer| peer.host), ..IncidentSubject::default() };
        let text = format!("{}{text}", prefix.unwrap_or_default());
        self.context.incidents.remark(IncidentKind::Connected, subject, text);
    }

    fn report(&self, kind: IncidentKind, peer: HostId, text: String) {
        let subject = IncidentSubject { peer: Some(peer), ..IncidentSubject::default() };
        self.context.incidents.report(kind, subject, text);
    }
}

/// Returns the failure that is sent to the peer. A full queue or a stopped model is an overload, after which a retry
/// may help; any other error is a failure of this sample.
fn failure_from_error(error: &InferenceError) -> Failure {
    match error {
        InferenceError::QueueFull { .. } | InferenceError::Stopped { .. } => {
            Failure::Overloaded(error.to_string())
        }
        InferenceError::Input { .. }
        | InferenceError::Failed { .. }
        | InferenceError::Server { .. }
        | InferenceError::Panicked { .. }
        | InferenceError::Cancelled { .. } => Failure::Failed(error.to_peer()),
    }
}
