//! The serving side: sessions of peers that want this host's models.

mod doors;
mod reflector;

pub(crate) use doors::{Doors, calibration};
pub use reflector::ReflectorError;

use std::collections::HashMap;
use std::sync::Arc;

use peernet_inference::{Done, InferenceError, Job, LoadError, Pool};
use peernet_logger::stream::{HostClock, IncidentKind};
use peernet_logger::{HostId, Slug};
use peernet_networks::{
    Announcer, Failure, Incoming, IncomingRequest, Listener, OpenRequest, SessionAccepted, SessionId,
};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use self::doors::to_peers;
use crate::host::{Host, VERSION};
use crate::incidents::Concerning;

/// Serves until it is told to stop. The error is why a port was lost.
pub(crate) async fn run(doors: Doors, host: Host, stop: CancellationToken) -> Result<(), String> {
    let named = Named { probes: doors.probes(), instance: doors.instance };
    let announcer = doors.listener.announcer();
    let announcing = announce(host.own.clone(), announcer, stop.clone());
    let reflecting = async {
        match doors.reflector {
            Some(reflector) => reflector.run(stop.clone()).await,
            None => Ok(()),
        }
    };
    let serving = sessions(doors.listener, host, named, stop.clone());
    let ((), (), ()) = tokio::try_join!(serving, reflecting, announcing)?;
    Ok(())
}

/// Tells all peers at once what becomes known of this host's clock.
async fn announce(
    mut own: watch::Receiver<HostClock>,
    announcer: Announcer,
    stop: CancellationToken,
) -> Result<(), String> {
    while let Some(Ok(())) = stop.run_until_cancelled(own.changed()).await {
        let clock = own.borrow_and_update().clone();
        announcer.announce(to_peers(clock));
    }
    Ok(())
}

/// Serves sessions until it is told to stop.
async fn sessions(
    mut listener: Listener,
    host: Host,
    named: Named,
    stop: CancellationToken,
) -> Result<(), String> {
    let mut server = Server { host, named, peers: HashMap::new() };
    // Models that are being loaded for a peer; the listener bounds how many peers there are.
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
            incoming = listener.next() => match incoming {
                Some(Incoming::Request(request)) => server.compute(request),
                Some(Incoming::Open(wish)) => {
                    let bank = Arc::clone(&server.host.bank);
                    loading.spawn_blocking(move || {
                        let pool = bank.load(&wish.hello.model, wish.hello.device.as_deref());
                        Loaded { wish, pool }
                    });
                }
                Some(Incoming::Closed(session)) => server.closed(session),
                None => return Err(format!("the port at {} was lost", listener.address())),
            },
        }
    }
    listener.close().await;
    Ok(())
}

/// How a peer finds the one whose clock it must know.
#[derive(Clone, Copy, Debug)]
struct Named {
    /// The port at which probes are answered.
    probes: Option<u16>,
    /// Who answers them.
    instance: u64,
}

/// A wish for a session whose model has been loaded, or could not be.
struct Loaded {
    wish: OpenRequest,
    pool: Result<Arc<Pool>, LoadError>,
}

/// A peer with a session.
struct Peer {
    host: HostId,
    name: Slug,
    pipeline: Slug,
    pool: Arc<Pool>,
}

struct Server {
    host: Host,
    named: Named,
    peers: HashMap<SessionId, Peer>,
}

impl Server {
    /// Accepts or refuses.
    fn answer(&mut self, Loaded { wish, pool }: Loaded) {
        let hello = &wish.hello;
        let (host, name, pipeline) = (hello.host, hello.name.clone(), hello.pipeline.clone());
        match pool {
            Ok(pool) => {
                let text =
                    format!("{name} opened a session for its pipeline {pipeline} with {}", pool.name());
                let (session, accepted) = (wish.session, self.accepted(&pool));
                if wish.accept(accepted) {
                    self.peers.insert(session, Peer { host, name, pipeline, pool });
                    self.report(IncidentKind::Connected, host, text);
                }
            }
            Err(error) => {
                let reason = error.to_string();
                let text = format!("refused a session to pipeline {pipeline} of {name}: {reason}");
                wish.refuse(reason);
                self.report(IncidentKind::Refused, host, text);
            }
        }
    }

    fn accepted(&self, pool: &Pool) -> SessionAccepted {
        SessionAccepted {
            host: self.host.id,
            name: self.host.name.clone(),
            clock: self.host.clock.identity().clone(),
            version: VERSION.to_owned(),
            model: pool.name().clone(),
            device: pool.device(),
            facts: pool.facts(),
            host_clock: to_peers(self.host.own.borrow().clone()),
            probes: self.named.probes,
            instance: self.named.instance,
        }
    }

    /// Hands a request to its model; whoever computes it sends the answer.
    fn compute(&self, request: IncomingRequest) {
        let IncomingRequest { session, sample, log, received, reply } = request;
        let Some(peer) = self.peers.get(&session) else {
            reply.send(log, Err(Failure::Failed("the session is not open".to_owned())));
            return;
        };
        let reply = Box::new(move |Done { log, result }: Done| {
            reply.send(log, result.map_err(|error| failure(&error)));
        });
        if let Err(refused) = peer.pool.submit(Job { sample, log, received: received.mono, reply }) {
            let Job { log, reply, .. } = *refused.job;
            reply(Done { log, result: Err(refused.reason) });
        }
    }

    fn closed(&mut self, session: SessionId) {
        // A session that was never accepted has nothing to take leave of.
        if let Some(Peer { host, name, pipeline, .. }) = self.peers.remove(&session) {
            let text = format!("the session of {name} for its pipeline {pipeline} is over");
            // An edge that lost its cloud says so itself; seen from here every session ends once.
            let what = Concerning { peer: Some(host), ..Concerning::default() };
            self.host.incidents.note(IncidentKind::Disconnected, what, text);
        }
    }

    fn report(&self, kind: IncidentKind, peer: HostId, text: String) {
        let what = Concerning { peer: Some(peer), ..Concerning::default() };
        self.host.incidents.report(kind, what, text);
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
