//! `zmq-tcp`: ZMTP 3.1 over TCP, a DEALER on the edge and a ROUTER on the cloud.
//!
//! The edge uses a socket of the ZeroMQ library, with the library's latency profile; the cloud uses
//! [`zmtp`](super::zmtp). On both ends, the task that sends a message also writes the message to the connection. The
//! connection's own task writes only the bytes that the kernel does not accept at once. The library does not reconnect,
//! because a session ends with its connection.

use std::io;
use std::num::NonZeroUsize;
use std::time::Duration;

use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use zeromq::message::MAX_INLINE_PAYLOAD;
use zeromq::options::WorkloadProfile;
use zeromq::{
    DisconnectReason, Error, Message, MonitorEvent, MonitorStream, Options, Payload, PeerIdent, PeerInfo,
    ReconnectPolicy, Socket, SocketType, TrySendError,
};

use super::tcp_info::tcp_statistics;
use super::zmtp::{ListenerLimits, ZmtpListener, ZmtpSender};
use super::{
    AddressForm, BindFailure, BoundPort, CLOSED_HERE, CloudReceiver, CloudSender, ConnectionId, DialContext,
    DialFailure, Disconnection, EdgeConnection, EdgeEvent, EdgeReceiver, EdgeSender, Frames, HostChecks,
    ListenerEvent, Peer, SendFailure, SendOptions,
};
use crate::descriptors::DescriptorShare;
use crate::message::MAX_FRAMES;
use crate::statistics::{ConnectionAddresses, TransportStatistics};
use crate::{Address, SessionSettings};

/// Form of addresses.
pub(crate) const ADDRESS_FORM: AddressForm = AddressForm::HostPort;

/// This network works on every host.
pub(crate) const HOST_CHECKS: HostChecks = HostChecks::NONE;

/// Identity in the ZMTP handshake of a cloud's port, since version 0.3 of the program. If nobody answers an edge's
/// hello, this identity tells the edge that a cloud listens at the address. Other programs have a ROUTER, too, for
/// example an aggregator.
const CLOUD_IDENTITY: &str = "peernet-serve";

/// Smallest payload frame that is read from the kernel straight into a separate buffer. Bytes.
const DIRECT_READ_BYTES: usize = 16 * 1024;

/// Time after which the library would reconnect. This time never passes: the session ends with its connection, and the
/// socket is then closed.
const RECONNECT_INTERVAL: Duration = Duration::from_secs(365 * 24 * 3600);

/// Time limit for finding out why a connection attempt failed.
const DIAGNOSIS_TIMEOUT: Duration = Duration::from_secs(1);

/// Returns the largest message as the library counts it: the bytes of all frames, and the size of one slot per frame.
fn library_message_bytes(settings: &SessionSettings) -> usize {
    let slots = MAX_FRAMES * size_of::<Payload>();
    usize::try_from(settings.max_message_bytes).unwrap_or(usize::MAX).saturating_add(slots)
}

/// Returns the capacity of a queue in messages: one for each request in flight, and 16 for the messages that open and
/// close sessions.
const fn queue_capacity(settings: &SessionSettings) -> u32 {
    settings.max_in_flight.saturating_add(16)
}

fn options(settings: &SessionSettings) -> Options {
    let queue = queue_capacity(settings);
    Options::default()
        .workload_profile(WorkloadProfile::Latency)
        .max_message_size(library_message_bytes(settings))
        .large_message_threshold(DIRECT_READ_BYTES)
        .send_hwm(queue)
        .recv_hwm(queue)
        .heartbeat_interval(settings.heartbeat_interval())
        .heartbeat_timeout(settings.heartbeat_timeout())
        // The time limit for the acknowledgment of sent bytes is the same as for a heartbeat.
        .tcp_user_timeout(settings.heartbeat_timeout())
        .reconnect(ReconnectPolicy::Fixed(RECONNECT_INTERVAL))
        // Only a socket that is dropped without `close` uses this value.
        .linger(Duration::ZERO)
}

fn to_message(frames: Frames) -> Message {
    Message::multipart_payloads(frames.into_iter().map(|frame| {
        // Short frames are stored inside the payload without an allocation.
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

fn to_send_result(result: Result<(), TrySendError>) -> Result<(), SendFailure> {
    result.map_err(|failure| match failure {
        TrySendError::Full(_) => SendFailure::Full,
        TrySendError::Closed => SendFailure::Gone("the connection is closed".into()),
        TrySendError::Error(error) => SendFailure::Gone(error.to_string()),
    })
}

fn reason_text(reason: &DisconnectReason) -> String {
    match reason {
        DisconnectReason::PeerClosed => "the peer closed the connection".into(),
        DisconnectReason::LocalClose => CLOSED_HERE.into(),
        DisconnectReason::Error(text) => text.clone(),
        other => format!("{other:?}"),
    }
}

/// Connects to a cloud's port.
pub(crate) async fn dial(
    address: &Address,
    settings: &SessionSettings,
    _context: &DialContext<'_>,
) -> Result<EdgeConnection, DialFailure> {
    let options = options(settings).handshake_timeout(settings.open_timeout());
    let socket = Socket::try_new(SocketType::Dealer, options).map_err(unreachable_failure)?;
    let mut monitor = socket.monitor();
    socket.connect(address.to_string()).await.map_err(unreachable_failure)?;
    let (addresses, peer_is_cloud) = loop {
        match monitor.recv().await {
            Ok(MonitorEvent::HandshakeSucceeded { peer, .. }) => {
                let identity = peer.peer_identity.as_deref();
                break (addresses(&peer), identity == Some(CLOUD_IDENTITY.as_bytes()));
            }
            Ok(MonitorEvent::HandshakeFailed { reason, .. }) => {
                return Err(DialFailure::Unreachable(format!(
                    "the program at this address does not speak ZMTP ({reason})"
                )));
            }
            Ok(MonitorEvent::Disconnected { reason, .. } | MonitorEvent::ConnectStopped { reason, .. }) => {
                return Err(DialFailure::Unreachable(reason_text(&reason)));
            }
            // The attempt failed, and the library waits until its next attempt.
            Ok(MonitorEvent::ConnectDelayed { .. }) => return Err(diagnose(address).await),
            Ok(_) => {}
            Err(error) => return Err(DialFailure::Unreachable(error.to_string())),
        }
    };
    let receiver = DealerReceiver { socket: socket.clone(), monitor, end_reason: None };
    let sender = Box::new(DealerSender { socket, addresses });
    Ok(EdgeConnection { sender, receiver: Box::new(receiver), peer_is_cloud })
}

/// Returns the addresses of both ends of a connection, as the library reports them.
fn addresses(peer: &PeerInfo) -> Option<ConnectionAddresses> {
    let socket_address = |end: &Option<PeerIdent>| match end {
        Some(PeerIdent::Socket(address)) => Some(*address),
        _ => None,
    };
    let diagnostics = &peer.diagnostics;
    Some(ConnectionAddresses {
        local: socket_address(&diagnostics.local_address)?,
        remote: socket_address(&diagnostics.remote_address)?,
    })
}

fn unreachable_failure(error: Error) -> DialFailure {
    match error {
        Error::Timeout => DialFailure::TimedOut,
        error => DialFailure::Unreachable(error.to_string()),
    }
}

/// Connects once more to find out why a connection attempt failed, because the library does not return the reason.
async fn diagnose(address: &Address) -> DialFailure {
    match tokio::time::timeout(DIAGNOSIS_TIMEOUT, tokio::net::TcpStream::connect(address.authority())).await {
        // The system's text begins with a capital letter, but becomes a part of a sentence.
        Ok(Err(error)) => DialFailure::Unreachable(error.to_string().to_lowercase()),
        Ok(Ok(_)) => DialFailure::Unreachable("the connection was lost while it was being opened".into()),
        Err(_) => DialFailure::TimedOut,
    }
}

#[derive(Debug)]
struct DealerSender {
    socket: Socket,
    addresses: Option<ConnectionAddresses>,
}

impl EdgeSender for DealerSender {
    // The options are not used: TCP retransmits lost data, so neither the deadline nor the tag matters.
    fn send(&self, frames: Frames, _options: SendOptions) -> Result<(), SendFailure> {
        to_send_result(self.socket.try_send(to_message(frames)))
    }

    fn addresses(&self) -> Option<ConnectionAddresses> {
        self.addresses
    }

    fn statistics(&self) -> TransportStatistics {
        self.addresses.as_ref().map(tcp_statistics).unwrap_or_default()
    }
}

#[derive(Debug)]
struct DealerReceiver {
    socket: Socket,
    monitor: MonitorStream,
    /// Reason why the connection ended. Messages that had arrived before are still returned.
    end_reason: Option<String>,
}

impl EdgeReceiver for DealerReceiver {
    fn receive(&mut self) -> BoxFuture<'_, Result<EdgeEvent, Disconnection>> {
        Box::pin(async {
            let to_event = |message: &Message| Ok(EdgeEvent::Message(to_frames(message)));
            loop {
                // Messages that arrived before the end of the connection are still returned.
                if let Some(reason) = &self.end_reason {
                    return self
                        .socket
                        .try_recv()
                        .map_or_else(|_| Err(Disconnection(reason.clone())), |m| to_event(&m));
                }
                tokio::select! {
                    // The choice is biased, so that messages that arrived before the end of the connection are returned
                    // first.
                    biased;
                    message = self.socket.recv() => {
                        return message.map_or_else(|error| Err(Disconnection(error.to_string())), |m| to_event(&m));
                    }
                    event = self.monitor.recv() => match event {
                        Ok(MonitorEvent::Disconnected { reason, .. }) => self.end_reason = Some(reason_text(&reason)),
                        // One connection causes few events. An overflow of the monitor means that the peer misbehaves.
                        Err(error) => self.end_reason = Some(error.to_string()),
                        Ok(_) => {}
                    },
                }
            }
        })
    }

    fn close(self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()> {
        Box::pin(async move {
            if let Err(error) = self.socket.close_with_linger(Some(linger)).await {
                tracing::debug!(%error, "cannot close the connection cleanly");
            }
        })
    }
}

/// Binds a socket and closes the socket again.
pub(crate) fn try_bind(address: &Address) -> io::Result<()> {
    std::net::TcpListener::bind((address.host().as_str(), address.port())).map(drop)
}

/// Listens on a port.
pub(crate) async fn bind(
    address: &Address,
    settings: &SessionSettings,
    ports: NonZeroUsize,
    _clock: &SharedClock,
) -> Result<BoundPort, BindFailure> {
    let listener =
        ZmtpListener::bind_as(CLOUD_IDENTITY, &address.authority(), limits(settings, ports)).await?;
    let bound = listener.address();
    let sender = Box::new(listener.sender());
    let (address, receiver) = (address.with_ip(bound.ip(), bound.port()), Box::new(listener));
    Ok(BoundPort { address, caveat: None, sender, receiver })
}

fn limits(settings: &SessionSettings, ports: NonZeroUsize) -> ListenerLimits {
    ListenerLimits {
        max_connections: DescriptorShare::DataPort.max_connections_per_port(ports),
        max_message_bytes: library_message_bytes(settings),
        max_unfinished_bytes: settings.max_unfinished_bytes,
        hello_timeout: settings.hello_timeout(),
        max_queued_messages: queue_capacity(settings) as usize,
        max_queued_bytes: library_message_bytes(settings),
        heartbeat_interval: settings.heartbeat_interval(),
        heartbeat_timeout: settings.heartbeat_timeout(),
    }
}

impl CloudSender for ZmtpSender {
    fn send(&self, peer: &Peer, frames: Frames, _options: SendOptions) -> Result<(), SendFailure> {
        self.try_send(peer.connection, frames)
    }

    // These methods call the methods of the same names that `ZmtpSender` has without the trait.
    fn note_hello(&self, connection: ConnectionId) {
        Self::note_hello(self, connection);
    }

    fn admit(&self, connection: ConnectionId) {
        Self::admit(self, connection);
    }

    fn demote(&self, connection: ConnectionId) {
        Self::demote(self, connection);
    }

    fn statistics(&self, connection: ConnectionId) -> TransportStatistics {
        self.addresses(connection).as_ref().map(tcp_statistics).unwrap_or_default()
    }
}

impl CloudReceiver for ZmtpListener {
    fn receive(&mut self) -> BoxFuture<'_, Option<ListenerEvent>> {
        Box::pin(Self::receive(self))
    }

    fn close(self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()> {
        Box::pin(Self::close(*self, linger))
    }
}
