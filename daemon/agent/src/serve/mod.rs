//! Serving: sessions of peers that use this host's models.
//!
//! A request goes to the pool of its session's model, whose worker records `queue`, `preprocessing`, `inference` and
//! `postprocessing`. The answer carries only the nodes that were added to the tree. Sessions that ask for
//! `observed-stamps` get the stamps of observed messages instead of a model.

mod endpoints;
mod listeners;
mod reflector;
mod request_counts;
mod served;
mod service;

pub(crate) use endpoints::{ServeEndpoints, calibration};
pub use served::ServedCounts;

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use peernet_inference::{Bank, Done, InferenceError};
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
use crate::same_clock::ClockWitness;
use crate::telemetry;

/// The parts of the agent that serving uses.
#[derive(Clone, Debug)]
pub(crate) struct ServeContext {
    pub(crate) host: Host,
    pub(crate) incidents: Incidents,
    /// Models that are served.
    pub(crate) bank: Arc<Bank>,
    /// Stamps of the messages that this host's pipelines observe, which peers may ask for.
    pub(crate) observed: ObservedPipelines,
    /// State of this host's own clocks.
    pub(crate) own: watch::Receiver<PeerClock>,
    /// Paths in /proc and /sys that show what can disturb a run.
    pub(crate) inspection: Arc<InspectionSettings>,
}

/// Reason why serving ended before it was asked to.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ServeError {
    /// The port for sessions was lost.
    #[error("the port at {0} was lost")]
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
        probes: endpoints.probes,
        instance: endpoints.instance,
        probe_key: endpoints.probe_key,
        built_in: endpoints.built_in,
    };
    let own = context.own.clone();
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
        probing: endpoints.reflectors.iter().map(Reflector::peers).collect(),
        request_counts: RequestCounts::default(),
        caveats,
    };
    let announcers = endpoints.listeners.iter().map(Listener::announcer).collect();
    let announcing = async {
        announce(own, announcers, stop.clone()).await;
        Ok(())
    };
    let reflectors = endpoints.reflectors.into_iter().map(|reflector| reflector.run(stop.clone()));
    let reflecting = async {
        futures::future::try_join_all(reflectors).await?;
        Ok(())
    };
    let serving = sessions(Listeners::new(endpoints.listeners), server, stop.clone());
    let ((), (), ()) = tokio::try_join!(serving, reflecting, announcing)?;
    Ok(())
}

/// Interval at which the statistics of this end of each connection are sent.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// Sends changes of this host's clocks to all peers at once, and the statistics of each connection periodically.
async fn announce(mut own: watch::Receiver<PeerClock>, announcers: Vec<Announcer>, stop: CancellationToken) {
    let announcing = async {
        while own.changed().await.is_ok() {
            let clock = own.borrow_and_update().clone();
            for announcer in &announcers {
                announcer.announce(clock.clone());
            }
        }
    };
    let reporting = async {
        let mut due = tokio::time::interval(REPORT_INTERVAL);
        due.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            due.tick().await;
            let announcers = announcers.clone();
            // On a blocking thread, because the system is queried for each connection, which must not delay sessions.
            let report = move || announcers.iter().for_each(Announcer::report_statistics);
            if let Err(error) = tokio::task::spawn_blocking(report).await {
                tracing::error!(%error, "reporting what was counted on connections panicked");
                return;
            }
        }
    };
    stop.run_until_cancelled(async { tokio::join!(announcing, reporting) }).await;
}

/// Serves sessions until `stop` is cancelled.
async fn sessions(
    mut listeners: Listeners,
    mut server: Server,
    stop: CancellationToken,
) -> Result<(), ServeError> {
    // Models that are being loaded for a peer. Each listener bounds the number of its peers.
    let mut loading: JoinSet<Loaded> = JoinSet::new();
    let mut stopping = std::pin::pin!(stop.cancelled());
    loop {
        tokio::select! {
            biased;
            () = &mut stopping => break,
            Some(loaded) = loading.join_next() => match loaded {
                Ok(loaded) => server.answer(loaded),
                // The panic dropped the request, which refuses it.
                Err(error) => tracing::error!(%error, "loading a model for a peer panicked"),
            },
            (listener, incoming) = listeners.next() => match incoming {
                Some(Incoming::Request(request)) => server.compute(request),
                Some(Incoming::Open(wish)) => {
                    let context = server.context.clone();
                    // On a blocking thread: a model may load for minutes, and other peers are served meanwhile.
                    loading.spawn_blocking(move || prepare(wish, listener, &context));
                }
                Some(Incoming::Closed { session, said_goodbye, ordered }) => {
                    server.closed(session, said_goodbye, ordered);
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

/// Prepares what a peer asks for. Blocks while a model loads.
fn prepare(wish: OpenRequest, listener: usize, context: &ServeContext) -> Loaded {
    // Inspected first, because loading a model is a competing load itself.
    let conditions = conditions(context);
    let service = Service::prepare(&wish.hello, context);
    Loaded { wish, listener, service, conditions }
}

/// Returns the conditions of this host that a peer is sent with its session.
fn conditions(context: &ServeContext) -> Vec<Condition> {
    let mut found = crate::conditions::inspect_host(&context.inspection, context.host.name.as_str());
    found.truncate(MAX_CONDITIONS);
    found
}

/// Facts about this process that its sessions need.
#[derive(Clone, Debug)]
struct ServeIdentity {
    /// Ports for probes, one for each listener.
    probes: Vec<Option<u16>>,
    /// Random number of this process, which answers the probes.
    instance: u64,
    /// Key that authenticates probes if none is configured.
    probe_key: Option<ProbeKey>,
    /// Built-in model for calibrations, whose answers are not counted as served.
    built_in: Option<Slug>,
}

/// A request for a session after its model was loaded, or could not be.
struct Loaded {
    wish: OpenRequest,
    /// Index of the listener at which it arrived.
    listener: usize,
    service: Result<Service, Refusal>,
    conditions: Vec<Condition>,
}

/// A peer with a session.
struct Peer {
    host: HostId,
    name: Slug,
    pipeline: Slug,
    /// Address of its connection, and so of its probes.
    address: Option<IpAddr>,
    service: Service,
    /// Counters of its requests and their answers; `None` if they are not counted.
    counted: Option<(Arc<AtomicU64>, Arc<watch::Sender<ServedCounts>>)>,
    /// Task that proves to the peer that both processes read one clock, if they do. It ends with the session; if it
    /// ends before, the peer notices.
    _witness: Option<AbortOnDropHandle<()>>,
}

struct Server {
    context: ServeContext,
    serve_identity: ServeIdentity,
    /// Hardware of this host.
    hardware: Hardware,
    served: Arc<watch::Sender<ServedCounts>>,
    peers: HashMap<SessionId, Peer>,
    /// Channels that give each reflector the addresses of the peers with a session.
    probing: Vec<watch::Sender<Vec<IpAddr>>>,
    request_counts: RequestCounts,
    /// Caveat about the connections of each listener, if there is one.
    caveats: Vec<Option<String>>,
}

impl Server {
    /// Accepts or refuses a session.
    fn answer(&mut self, Loaded { wish, listener, service, conditions }: Loaded) {
        let hello = &wish.hello;
        let (host, name, pipeline) = (hello.host, hello.name.clone(), hello.pipeline.clone());
        match service {
            Ok(service) => {
                let caveat = self.caveats.get(listener).and_then(Option::as_ref);
                let caveat = caveat.map(|caveat| format!("; {caveat}")).unwrap_or_default();
                let text = format!(
                    "{name} opened a session for its pipeline {pipeline} with {}{caveat}",
                    service.name()
                );
                let (session, accepted) = (wish.session, self.accepted(listener, &service, conditions));
                let address = wish.address.map(|address| address.ip());
                // Connected before the edge knows that it has the session, because it closes its socket then.
                let witness = ClockWitness::connect(hello, session, &self.context.host.clock);
                let witness = witness.map(|it| AbortOnDropHandle::new(tokio::spawn(it.answer())));
                // Announced before the peer knows where to send its probes.
                self.tell_reflectors(address);
                if wish.accept(accepted) {
                    let counts = match &service {
                        Service::Model(pool) => self.serve_identity.built_in.as_ref() != Some(pool.name()),
                        Service::Stamps(..) => false,
                    };
                    let counted =
                        counts.then(|| (self.request_counts.by(host, &pipeline), Arc::clone(&self.served)));
                    let peer = Peer { host, name, pipeline, address, service, counted, _witness: witness };
                    self.peers.insert(session, peer);
                    self.served.send_modify(|served| served.sessions = self.peers.len());
                    self.report(IncidentKind::Connected, host, text);
                } else {
                    self.tell_reflectors(None);
                }
            }
            Err(Refusal { reason, to_peer }) => {
                let text = format!("refused a session to pipeline {pipeline} of {name}: {reason}");
                wish.refuse(to_peer);
                self.report(IncidentKind::Refused, host, text);
            }
        }
    }

    /// Gives the reflectors the addresses that have a session, and that of a session being opened.
    fn tell_reflectors(&self, opening: Option<IpAddr>) {
        for probing in &self.probing {
            let open = self.peers.values().filter_map(|peer| peer.address);
            probing.send_replace(open.chain(opening).collect());
        }
    }

    fn accepted(&self, listener: usize, service: &Service, conditions: Vec<Condition>) -> SessionAccepted {
        SessionAccepted {
            host: self.context.host.id,
            name: self.context.host.name.clone(),
            clock: self.context.host.clock.identity().clone(),
            version: self.context.host.version.to_owned(),
            model: service.name(),
            device: service.device(),
            facts: service.facts(),
            host_clock: self.context.own.borrow().clone(),
            probes: self.serve_identity.probes.get(listener).copied().flatten(),
            instance: self.serve_identity.instance,
            probe_key: self.serve_identity.probe_key,
            conditions,
            hardware: self.hardware.clone(),
        }
    }

    /// Passes a request to its service, which sends the answer.
    fn compute(&self, request: IncomingRequest) {
        let Some(peer) = self.peers.get(&request.session) else {
            let IncomingRequest { log, reply, .. } = request;
            reply.send(log, Err(Failure::Failed("the session is not open".to_owned())));
            return;
        };
        let served = peer.counted.as_ref().map(|(requests, served)| {
            requests.fetch_add(1, Ordering::Relaxed);
            Arc::clone(served)
        });
        peer.service.answer(request, move |Done { log, result }: &Done| {
            if let Some(served) = served {
                let inference = result.as_ref().ok().and_then(|_| served::inference(log.tree()));
                served.send_modify(|served| served.add(result.is_err(), inference));
            }
        });
    }

    /// Handles the end of a session. A goodbye is not an incident, because every session ends.
    fn closed(&mut self, session: SessionId, said_goodbye: bool, ordered: Option<u64>) {
        // A session that was never accepted is not in the map.
        let Some(Peer { host, name, pipeline, counted, .. }) = self.peers.remove(&session) else { return };
        self.tell_reflectors(None);
        let is_goodbye = said_goodbye && counted.is_some();
        let missed = if is_goodbye { self.request_counts.missed(host, &pipeline, ordered) } else { 0 };
        self.served.send_modify(|served| {
            served.sessions = self.peers.len();
            served.missed = served.missed.saturating_add(missed);
        });
        if said_goodbye {
            tracing::info!("the session of {name} for its pipeline {pipeline} is over");
        } else {
            let text =
                format!("lost {name}: the session for its pipeline {pipeline} ended without a goodbye");
            self.report(IncidentKind::Disconnected, host, text);
        }
    }

    /// Reports a caveat of a connection, with the peer that has a session on it.
    fn remark(&self, session: Option<SessionId>, text: &str) {
        let peer = session.and_then(|session| self.peers.get(&session));
        let of =
            peer.map(|peer| format!("the session of {} for its pipeline {}: ", peer.name, peer.pipeline));
        let subject = IncidentSubject { peer: peer.map(|peer| peer.host), ..IncidentSubject::default() };
        let text = format!("{}{text}", of.unwrap_or_default());
        self.context.incidents.remark(IncidentKind::Connected, subject, text);
    }

    fn report(&self, kind: IncidentKind, peer: HostId, text: String) {
        let subject = IncidentSubject { peer: Some(peer), ..IncidentSubject::default() };
        self.context.incidents.report(kind, subject, text);
    }
}

/// Returns the failure for the peer: whether another try may help, or this sample is at fault.
fn failure(error: &InferenceError) -> Failure {
    match error {
        InferenceError::QueueFull { .. } | InferenceError::Stopped { .. } => {
            Failure::Overloaded(error.to_string())
        }
        InferenceError::Input { .. } | InferenceError::Failed { .. } | InferenceError::Panicked { .. } => {
            Failure::Failed(error.to_string())
        }
    }
}
