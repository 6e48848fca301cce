//! The serving side: sessions of peers that want this host's models.

mod asked;
mod endpoints;
mod listeners;
mod reflector;
mod served;
mod service;

pub(crate) use endpoints::{ServeEndpoints, calibration};
pub use served::Served;

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

use self::asked::Asked;
use self::listeners::Listeners;
use self::service::{Refusal, Service};
use crate::conditions::InspectionSettings;
use crate::host::Host;
use crate::incidents::{IncidentContext, Incidents, remark};
use crate::observed::ObservedPipelines;
use crate::same_clock::ClockWitness;
use crate::telemetry;

/// What serving needs of the rest of the agent.
#[derive(Clone, Debug)]
pub(crate) struct ServeContext {
    pub(crate) host: Host,
    pub(crate) incidents: Incidents,
    /// The models that are served.
    pub(crate) bank: Arc<Bank>,
    /// What peers can ask about this host's pipelines that observe.
    pub(crate) observed: ObservedPipelines,
    /// What is known of this host's own clock.
    pub(crate) own: watch::Receiver<PeerClock>,
    /// Paths in /proc and /sys that show what can disturb a run.
    pub(crate) inspection: Arc<InspectionSettings>,
}

/// Why serving ended before it was told to.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ServeError {
    /// The port for sessions was lost.
    #[error("the port at {0} was lost")]
    PortLost(Address),
    /// The port for probes was lost.
    #[error(transparent)]
    Reflector(#[from] ReceiveError),
}

/// Serves at all ports until it is told to stop, and counts the answers. The error is why a port was lost.
pub(crate) async fn run(
    endpoints: ServeEndpoints,
    context: ServeContext,
    served: watch::Sender<Served>,
    stop: CancellationToken,
) -> Result<(), ServeError> {
    let named = Named {
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
        named,
        hardware,
        served,
        peers: HashMap::new(),
        probing: endpoints.reflectors.iter().map(Reflector::peers).collect(),
        asked: Asked::default(),
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

/// Time between two reports of what was counted on a connection at this end.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// Tells all peers at once what becomes known of this host's clock, and again and again what was counted on their connections.
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
            // The system is asked about each connection, for which sessions are not to wait.
            let report = move || announcers.iter().for_each(Announcer::report_statistics);
            if let Err(error) = tokio::task::spawn_blocking(report).await {
                tracing::error!(%error, "reporting what was counted on connections panicked");
                return;
            }
        }
    };
    stop.run_until_cancelled(async { tokio::join!(announcing, reporting) }).await;
}

/// Serves sessions until it is told to stop.
async fn sessions(
    mut listeners: Listeners,
    mut server: Server,
    stop: CancellationToken,
) -> Result<(), ServeError> {
    // Models that are being loaded for a peer; each listener bounds how many peers it has.
    let mut loading: JoinSet<Loaded> = JoinSet::new();
    let mut stopping = std::pin::pin!(stop.cancelled());
    loop {
        tokio::select! {
            biased;
            () = &mut stopping => break,
            Some(loaded) = loading.join_next() => match loaded {
                Ok(loaded) => server.answer(loaded),
                // The wish was dropped with the panic, and so refused.
                Err(error) => tracing::error!(%error, "loading a model for a peer panicked"),
            },
            (listener, incoming) = listeners.next() => match incoming {
                Some(Incoming::Request(request)) => server.compute(request),
                Some(Incoming::Open(wish)) => {
                    let context = server.context.clone();
                    loading.spawn_blocking(move || prepare(wish, listener, &context));
                }
                Some(Incoming::Closed { session, said_goodbye, ordered }) => {
                    server.closed(session, said_goodbye, ordered);
                }
                Some(Incoming::Remark { session, text }) => server.remark(session, &text),
                Some(Incoming::Refused { host, text }) => {
                    let what = IncidentContext { peer: host, ..IncidentContext::default() };
                    server.context.incidents.remark(IncidentKind::Refused, what, text);
                }
                None => return Err(ServeError::PortLost(listeners.address(listener).clone())),
            },
        }
    }
    listeners.close().await;
    Ok(())
}

/// Gets ready what a peer asks for. Blocks while a model loads.
fn prepare(wish: OpenRequest, listener: usize, context: &ServeContext) -> Loaded {
    // First, because a model that loads is a competing load itself.
    let conditions = conditions(context);
    let service = Service::prepare(&wish.hello, context);
    Loaded { wish, listener, service, conditions }
}

/// What a peer is told of this host before a session.
fn conditions(context: &ServeContext) -> Vec<Condition> {
    let mut found = crate::conditions::inspect_host(&context.inspection, context.host.name.as_str());
    found.truncate(MAX_CONDITIONS);
    found
}

/// How a peer finds the one whose clock it must know.
#[derive(Clone, Debug)]
struct Named {
    /// The port at which the probes of a listener's peers are answered, for each listener.
    probes: Vec<Option<u16>>,
    /// Who answers them.
    instance: u64,
    /// What authenticates them, where no configured key does.
    probe_key: Option<ProbeKey>,
    /// The model whose answers do not count.
    built_in: Option<Slug>,
}

/// A wish for a session whose model has been loaded, or could not be.
struct Loaded {
    wish: OpenRequest,
    /// The place of the listener that it came to.
    listener: usize,
    service: Result<Service, Refusal>,
    conditions: Vec<Condition>,
}

/// A peer with a session.
struct Peer {
    host: HostId,
    name: Slug,
    pipeline: Slug,
    /// Where its connection, and so its probes, come from.
    address: Option<IpAddr>,
    service: Service,
    /// Where its requests and their answers are counted, if they are.
    counted: Option<(Arc<AtomicU64>, Arc<watch::Sender<Served>>)>,
    /// Proves to it that both processes read one clock, where they do; goes with the session. If it ends before, the peer notices.
    _witness: Option<AbortOnDropHandle<()>>,
}

struct Server {
    context: ServeContext,
    named: Named,
    /// What this host is made of.
    hardware: Hardware,
    served: Arc<watch::Sender<Served>>,
    peers: HashMap<SessionId, Peer>,
    /// Tells each reflector the addresses of the peers with a session.
    probing: Vec<watch::Sender<Vec<IpAddr>>>,
    asked: Asked,
    /// What makes the connections of each listener worse than they could be.
    caveats: Vec<Option<String>>,
}

impl Server {
    /// Accepts or refuses.
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
                // Before the edge knows that it has the session: it closes its socket then.
                let witness = ClockWitness::connect(hello, session, &self.context.host.clock);
                let witness = witness.map(|it| AbortOnDropHandle::new(tokio::spawn(it.answer())));
                // Before the peer knows where to send its probes.
                self.tell_reflectors(address);
                if wish.accept(accepted) {
                    let counts = match &service {
                        Service::Model(pool) => self.named.built_in.as_ref() != Some(pool.name()),
                        Service::Stamps(..) => false,
                    };
                    let counted = counts.then(|| (self.asked.by(host, &pipeline), Arc::clone(&self.served)));
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

    /// Tells the reflectors which addresses have a session, with one that is being opened.
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
            probes: self.named.probes.get(listener).copied().flatten(),
            instance: self.named.instance,
            probe_key: self.named.probe_key,
            conditions,
            hardware: self.hardware.clone(),
        }
    }

    /// Hands a request to what answers it; whoever computes it sends the answer.
    fn compute(&self, request: IncomingRequest) {
        let Some(peer) = self.peers.get(&request.session) else {
            let IncomingRequest { log, reply, .. } = request;
            reply.send(log, Err(Failure::Failed("the session is not open".to_owned())));
            return;
        };
        let served = peer.counted.as_ref().map(|(asked, served)| {
            asked.fetch_add(1, Ordering::Relaxed);
            Arc::clone(served)
        });
        peer.service.answer(request, move |Done { log, result }: &Done| {
            if let Some(served) = served {
                let inference = result.as_ref().ok().and_then(|_| served::inference(log.tree()));
                served.send_modify(|served| served.add(result.is_err(), inference));
            }
        });
    }

    /// A session is over. That its peer took its leave is no incident: every session ends once.
    fn closed(&mut self, session: SessionId, said_goodbye: bool, ordered: Option<u64>) {
        // A session that was never accepted has nothing to take leave of.
        let Some(Peer { host, name, pipeline, counted, .. }) = self.peers.remove(&session) else { return };
        self.tell_reflectors(None);
        let is_farewell = said_goodbye && counted.is_some();
        let missed = if is_farewell { self.asked.missed(host, &pipeline, ordered) } else { 0 };
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

    /// Reports what makes a connection worse than it could be, with the peer that has a session on it.
    fn remark(&self, session: Option<SessionId>, text: &str) {
        let peer = session.and_then(|session| self.peers.get(&session));
        let of =
            peer.map(|peer| format!("the session of {} for its pipeline {}: ", peer.name, peer.pipeline));
        let what = IncidentContext { peer: peer.map(|peer| peer.host), ..IncidentContext::default() };
        let text = format!("{}{text}", of.unwrap_or_default());
        self.context.incidents.remark(IncidentKind::Connected, what, text);
    }

    fn report(&self, kind: IncidentKind, peer: HostId, text: String) {
        let what = IncidentContext { peer: Some(peer), ..IncidentContext::default() };
        self.context.incidents.report(kind, what, text);
    }
}

/// What a peer is told: whether another try may help, or this sample is at fault.
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
