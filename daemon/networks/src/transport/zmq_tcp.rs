//! `zmq-tcp`: ZMTP 3.1 over TCP, a DEALER on the edge and a ROUTER on the cloud.
//!
//! Both sockets run in the library's latency profile: the task that sends writes to the connection itself, and
//! only what the kernel does not take at once is left to the connection's own task.

use std::collections::HashSet;
use std::fmt;
use std::time::Duration;

use futures::future::BoxFuture;
use zeromq::message::MAX_INLINE_PAYLOAD;
use zeromq::options::WorkloadProfile;
use zeromq::{
    DisconnectReason, Error, IdentitySocket, Message, MonitorEvent, MonitorRecvError, MonitorStream, Options,
    Payload, PeerIdent, ReconnectPolicy, Socket, SocketType, TrySendError,
};

use super::{
    Arrival, BindFailure, Bound, CloudReceiver, CloudSender, ConnectionId, DialFailure, Dialled,
    EdgeReceiver, EdgeSender, Frames, Peer, SendFailure,
};
use crate::message::MAX_FRAMES;
use crate::{Address, SessionSettings};

/// Payload frames from this size on are read from the kernel straight into a buffer of their own.
const DIRECT_READ_BYTES: usize = 16 * 1024;

/// The library would dial again by itself; a session ends with its connection, so it must not.
const NEVER: Duration = Duration::from_secs(365 * 24 * 3600);

/// How long a connection may take to speak the protocol: strangers that stay silent hold a place no longer.
const HANDSHAKE: Duration = Duration::from_secs(2);

/// Connections that may be at that at once: far more than the library's 256, which a few silent strangers fill.
const MAX_HANDSHAKES: usize = 4096;

/// How long finding out why a connection failed may take.
const DIAGNOSIS: Duration = Duration::from_secs(1);

fn options(settings: &SessionSettings) -> Options {
    let slots = MAX_FRAMES * size_of::<Payload>();
    let largest = usize::try_from(settings.max_message_bytes).unwrap_or(usize::MAX).saturating_add(slots);
    // Places for every request in flight, and for the few messages that open and close a session.
    let queue = settings.max_in_flight.saturating_add(16);
    Options::default()
        .workload_profile(WorkloadProfile::Latency)
        .max_message_size(largest)
        .large_message_threshold(DIRECT_READ_BYTES)
        .send_hwm(queue)
        .recv_hwm(queue)
        .heartbeat_interval(settings.heartbeat_interval())
        .heartbeat_timeout(settings.heartbeat_timeout())
        .tcp_user_timeout(settings.heartbeat_timeout())
        .reconnect(ReconnectPolicy::Fixed(NEVER))
        .linger(Duration::ZERO)
}

fn to_message(frames: Frames) -> Message {
    Message::multipart_payloads(frames.into_iter().map(|frame| {
        if frame.len() <= MAX_INLINE_PAYLOAD {
            Payload::from_slice(&frame)
        } else {
            Payload::from_bytes(frame)
        }
    }))
}

fn to_frames(message: &Message) -> Frames {
    message.iter().collect()
}

fn sent(result: Result<(), TrySendError>) -> Result<(), SendFailure> {
    result.map_err(|failure| match failure {
        TrySendError::Full(_) => SendFailure::Full,
        TrySendError::Closed => SendFailure::Gone("the connection is closed".into()),
        TrySendError::Error(Error::Unroutable) => SendFailure::Gone("the peer is gone".into()),
        TrySendError::Error(error) => SendFailure::Gone(error.to_string()),
    })
}

fn reason_text(reason: &DisconnectReason) -> String {
    match reason {
        DisconnectReason::PeerClosed => "the peer closed the connection".into(),
        DisconnectReason::LocalClose => "the connection was closed here".into(),
        DisconnectReason::Error(text) => text.clone(),
        other => format!("{other:?}"),
    }
}

/// Connects to a cloud's port.
pub(crate) async fn dial(address: &Address, settings: &SessionSettings) -> Result<Dialled, DialFailure> {
    let options = options(settings).handshake_timeout(settings.open_timeout());
    let socket = Socket::try_new(SocketType::Dealer, options).map_err(unreachable)?;
    let mut monitor = socket.monitor();
    socket.connect(address.to_string()).await.map_err(unreachable)?;
    loop {
        match monitor.recv().await {
            Ok(MonitorEvent::HandshakeSucceeded { .. }) => break,
            Ok(MonitorEvent::HandshakeFailed { reason, .. }) => {
                return Err(DialFailure::Unreachable(format!("something else answers there ({reason})")));
            }
            Ok(MonitorEvent::Disconnected { reason, .. } | MonitorEvent::ConnectStopped { reason, .. }) => {
                return Err(DialFailure::Unreachable(reason_text(&reason)));
            }
            Ok(MonitorEvent::ConnectDelayed { .. }) => return Err(diagnose(address).await),
            Ok(_) => {}
            Err(error) => return Err(DialFailure::Unreachable(error.to_string())),
        }
    }
    let receiver = Dealer { socket: socket.clone(), monitor, ended: None };
    Ok(Dialled { sender: Box::new(DealerSender(socket)), receiver: Box::new(receiver) })
}

fn unreachable(error: Error) -> DialFailure {
    match error {
        Error::Timeout => DialFailure::TimedOut,
        error => DialFailure::Unreachable(error.to_string()),
    }
}

/// The library keeps to itself why a connection failed: the system is asked once more.
async fn diagnose(address: &Address) -> DialFailure {
    match tokio::time::timeout(DIAGNOSIS, tokio::net::TcpStream::connect(address.authority())).await {
        Ok(Err(error)) => DialFailure::Unreachable(error.to_string().to_lowercase()),
        Ok(Ok(_)) => DialFailure::Unreachable("the connection broke while it was set up".into()),
        Err(_) => DialFailure::TimedOut,
    }
}

#[derive(Debug)]
struct DealerSender(Socket);

impl EdgeSender for DealerSender {
    fn send(&self, frames: Frames) -> Result<(), SendFailure> {
        sent(self.0.try_send(to_message(frames)))
    }
}

#[derive(Debug)]
struct Dealer {
    socket: Socket,
    monitor: MonitorStream,
    /// Why the connection ended; what had arrived before is still handed out.
    ended: Option<String>,
}

impl EdgeReceiver for Dealer {
    fn receive(&mut self) -> BoxFuture<'_, Result<Frames, String>> {
        Box::pin(async {
            loop {
                if let Some(reason) = &self.ended {
                    return self
                        .socket
                        .try_recv()
                        .map_or_else(|_| Err(reason.clone()), |m| Ok(to_frames(&m)));
                }
                tokio::select! {
                    biased;
                    message = self.socket.recv() => {
                        return message.map_or_else(|error| Err(error.to_string()), |m| Ok(to_frames(&m)));
                    }
                    event = self.monitor.recv() => match event {
                        Ok(MonitorEvent::Disconnected { reason, .. }) => self.ended = Some(reason_text(&reason)),
                        // One connection makes a handful of events: more than the monitor holds is a peer gone wild.
                        Err(error) => self.ended = Some(error.to_string()),
                        Ok(_) => {}
                    },
                }
            }
        })
    }

    fn close(self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()> {
        Box::pin(async move {
            if let Err(error) = self.socket.close_with_linger(Some(linger)).await {
                tracing::debug!(%error, "closing the connection did not end cleanly");
            }
        })
    }
}

/// Listens on a port.
pub(crate) async fn bind(address: &Address, settings: &SessionSettings) -> Result<Bound, BindFailure> {
    let options = options(settings)
        .router_mandatory(true)
        .handshake_timeout(HANDSHAKE)
        .max_pending_handshakes(MAX_HANDSHAKES);
    let socket = Socket::try_new(SocketType::Router, options)
        .map_err(|error| BindFailure::Other(error.to_string()))?;
    let monitor = socket.monitor();
    let endpoint = socket.bind(address.to_string()).await.map_err(bind_failure)?;
    let address =
        endpoint.to_string().parse::<Address>().map_err(|error| BindFailure::Other(error.to_string()))?;
    let socket = socket.identity_routing().map_err(|error| BindFailure::Other(error.to_string()))?;
    let receiver = Router { socket: socket.clone(), monitor, known: HashSet::new(), gone: Vec::new() };
    Ok(Bound { address, sender: Box::new(RouterSender(socket)), receiver: Box::new(receiver) })
}

fn bind_failure(error: Error) -> BindFailure {
    use std::io::ErrorKind;
    match error {
        Error::Io(error) => match error.kind() {
            ErrorKind::AddrInUse => BindFailure::InUse,
            ErrorKind::PermissionDenied => BindFailure::Denied,
            ErrorKind::AddrNotAvailable => BindFailure::NotLocal,
            _ => BindFailure::Other(error.to_string()),
        },
        error => BindFailure::Other(error.to_string()),
    }
}

#[derive(Debug)]
struct RouterSender(IdentitySocket);

impl CloudSender for RouterSender {
    fn send(&self, peer: &Peer, frames: Frames) -> Result<(), SendFailure> {
        sent(self.0.try_send_to(&peer.route, to_message(frames)))
    }
}

#[derive(Debug)]
struct Router {
    socket: IdentitySocket,
    monitor: MonitorStream,
    /// Connections that a message was handed out of, until their end was.
    known: HashSet<u64>,
    /// Connections found to be gone after the monitor lost events.
    gone: Vec<u64>,
}

impl Router {
    /// The library names connections by a routing id that a peer may choose for itself, and hands a chosen one
    /// over to the next who claims it. Only ids made here are followed.
    fn arrived(&mut self, identity: &zeromq::Identity, message: &Message) -> Arrival {
        let info = identity.peer_info();
        if info.peer_identity.is_some() {
            return Arrival::Garbage(info.peer_address, "the peer chose a routing id of its own".into());
        }
        self.known.insert(info.connection_id);
        let peer = Peer {
            connection: ConnectionId(info.connection_id),
            route: identity.to_bytes(),
            address: info.peer_address,
        };
        Arrival::Message(peer, to_frames(message))
    }

    fn happened(&mut self, event: MonitorEvent) -> Option<Arrival> {
        match event {
            MonitorEvent::Disconnected { peer, reason, .. } => self
                .known
                .remove(&peer.connection_id)
                .then(|| Arrival::Gone(ConnectionId(peer.connection_id), reason_text(&reason))),
            MonitorEvent::HandshakeFailed { peer_ident, reason, .. } => {
                let address = match peer_ident {
                    PeerIdent::Socket(address) => Some(address),
                    _ => None,
                };
                Some(Arrival::Garbage(address, reason))
            }
            _ => None,
        }
    }

    /// After lost events: which of the known connections are still there?
    async fn look_again(&mut self) -> Result<(), Error> {
        let alive: HashSet<u64> = self.socket.connections().await?.iter().map(|c| c.connection_id).collect();
        self.gone = self.known.difference(&alive).copied().collect();
        self.known.retain(|connection| alive.contains(connection));
        Ok(())
    }
}

/// The listener's socket is gone; who listens learns no more than that.
fn lost(error: &dyn fmt::Display) -> Option<Arrival> {
    tracing::warn!(%error, "the listener's socket was closed");
    None
}

impl CloudReceiver for Router {
    fn receive(&mut self) -> BoxFuture<'_, Option<Arrival>> {
        Box::pin(async {
            loop {
                if let Some(connection) = self.gone.pop() {
                    return Some(Arrival::Gone(ConnectionId(connection), "the connection is gone".into()));
                }
                tokio::select! {
                    biased;
                    message = self.socket.recv_from() => return match message {
                        Ok((identity, message)) => Some(self.arrived(&identity, &message)),
                        Err(error) => lost(&error),
                    },
                    event = self.monitor.recv() => match event {
                        Ok(event) => if let Some(arrival) = self.happened(event) {
                            return Some(arrival);
                        },
                        Err(MonitorRecvError::Lagged(_)) => if let Err(error) = self.look_again().await {
                            return lost(&error);
                        },
                        Err(error) => return lost(&error),
                    },
                }
            }
        })
    }

    fn close(self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()> {
        Box::pin(async move {
            if let Err(error) = self.socket.into_inner().close_with_linger(Some(linger)).await {
                tracing::debug!(%error, "closing the listener did not end cleanly");
            }
        })
    }
}
