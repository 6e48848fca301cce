//! The edge's end of a connection over UDP.

use std::collections::VecDeque;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use nix::errno::Errno;
use peernet_clock::{MonoTime, Span};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};

use super::driver::{Machine, Port, time_since};
use super::radio::{self, PREFIX};
use super::socket::{ReceiveBuffers, UdpPort, source_address, unspecified_address};
use super::{connection_limits, local_terms, reassembly_limits, socket_buffer_bytes};
use crate::statistics::{ConnectionAddresses, TransportStatistics};
use crate::transport::datagram::connection::{Connection, Event};
use crate::transport::datagram::endpoint::Route;
use crate::transport::datagram::handshake::{DialState, HandshakeOutcome, PathTooSmall};
use crate::transport::datagram::packet::{Packet, Role, Terms};
use crate::transport::datagram::packet_writer::PacketWriter;
use crate::transport::datagram::sending::Batch;
use crate::transport::memory::{MemoryBudget, Reservation};
use crate::transport::{
    CLOSED_HERE, DialContext, DialFailure, Disconnection, EdgeConnection, EdgeEvent, EdgeReceiver,
    EdgeSender, Frames, SendFailure, SendOptions, discard_deliveries,
};
use crate::{Address, SessionSettings};

/// Number of unfinished messages of the largest length that may be held at the same time.
const MAX_UNFINISHED_MESSAGES: u64 = 4;

/// Opens a virtual connection to a cloud's port.
pub(crate) async fn dial(
    address: &Address,
    settings: &SessionSettings,
    _context: &DialContext<'_>,
) -> Result<EdgeConnection, DialFailure> {
    let resolved = tokio::net::lookup_host(address.authority()).await;
    dial_any(resolved.map_err(|error| unreachable_failure(&error))?, settings).await
}

/// Opens a connection to the first of these addresses at which a cloud answers. The next address is tried only if an
/// address is known to be unreachable.
async fn dial_any(
    addresses: impl IntoIterator<Item = SocketAddr>,
    settings: &SessionSettings,
) -> Result<EdgeConnection, DialFailure> {
    let mut failure = DialFailure::Unreachable("the name has no address".into());
    for peer in addresses {
        match dial_peer(peer, settings).await {
            // The cloud may listen at one of several addresses of its name: `localhost` is often `::1` and 127.0.0.1.
            Err(unreachable @ DialFailure::Unreachable(_)) => failure = unreachable,
            result => return result,
        }
    }
    Err(failure)
}

async fn dial_peer(peer: SocketAddr, settings: &SessionSettings) -> Result<EdgeConnection, DialFailure> {
    // The socket is not connected to the cloud, because the cloud may send from another port (as a RADIO does) and may
    // get another address.
    let socket = UdpPort::bind(SocketAddr::new(unspecified_address(peer), 0), socket_buffer_bytes(settings));
    let socket = socket.map_err(|error| unreachable_failure(&error))?;
    // If the system reports that the cloud's port is closed, the connection ends at once and not by silence.
    socket.report_errors().map_err(|error| unreachable_failure(&error))?;
    let start = Instant::now();
    let (id, terms, remark) = open(&socket, peer, local_terms(settings, &socket), start).await?;
    let largest_message_bytes = u64::from(reassembly_limits(settings).max_message_bytes);
    let budget = MemoryBudget::new(largest_message_bytes.saturating_mul(MAX_UNFINISHED_MESSAGES));
    let now = time_since(start, Instant::now());
    let connection = Connection::new(
        PacketWriter::new(Role::Edge, id, PREFIX),
        terms,
        connection_limits(settings),
        (reassembly_limits(settings), budget),
        now,
    );
    let (token, _) = uuid::Uuid::new_v4().as_u64_pair();
    let invalid_packets = VecDeque::new();
    let machine = EdgeEnd { peer, id, connection, remark, invalid_packets, token, path_check: None };
    let (port, deliveries) = Port::serve(socket, machine, start);
    let sender = Box::new(UdpEdgeSender(Arc::clone(&port)));
    Ok(EdgeConnection {
        sender,
        receiver: Box::new(UdpEdgeReceiver { port, deliveries }),
        // Only a cloud answers the handshake.
        peer_is_cloud: true,
    })
}

fn unreachable_failure(error: &io::Error) -> DialFailure {
    // The system's text begins with a capital letter, but becomes a part of a sentence.
    DialFailure::Unreachable(error.to_string().to_lowercase())
}

/// Runs the handshake until the cloud has opened a connection. Returns the number of the connection, the cloud's terms,
/// and a remark if the path carries only shorter datagrams than configured.
async fn open(
    socket: &UdpPort,
    peer: SocketAddr,
    terms: Terms,
    start: Instant,
) -> Result<(u64, Terms, Option<String>), DialFailure> {
    let (nonce, _) = uuid::Uuid::new_v4().as_u64_pair();
    // With port 0, the cloud answers to the port of this socket.
    let reply_port = 0;
    let mut dial_state =
        DialState::new(nonce, reply_port, terms, PREFIX.len(), time_since(start, Instant::now()));
    let mut buffers = ReceiveBuffers::new();
    let (route, mut out) = (Route { to: peer, from: None }, Vec::new());
    loop {
        let now = time_since(start, Instant::now());
        out.clear();
        out.extend_from_slice(PREFIX);
        let path_failure = |error: PathTooSmall| DialFailure::Unreachable(error.to_string());
        if dial_state.fill(&mut out, now).map_err(path_failure)? {
            let batch = Batch { segment: out.len(), count: 1 };
            match socket.try_send(route, &out, batch) {
                // The handshake repeats a packet that does not arrive.
                Ok(()) => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                // The datagram is longer than the MTU of the interface.
                Err(error) if error.raw_os_error() == Some(Errno::EMSGSIZE as i32) => {
                    dial_state.shorten(now).map_err(path_failure)?;
                }
                Err(error) => return Err(unreachable_failure(&error)),
            }
        }
        let next = start + Duration::from_nanos(u64::try_from(dial_state.next_timer().nanos()).unwrap_or(0));
        tokio::select! {
            result = socket.readable() => result.map_err(|error| unreachable_failure(&error))?,
            () = sleep_until(next) => continue,
        }
        let mut outcome = None;
        let received = socket.try_receive(&mut buffers, |source, _, datagram| {
            if source.ip() != peer.ip() {
                return;
            }
            if let Some(Ok(packet)) = radio::body(datagram).map(|body| Packet::read(Role::Edge, body)) {
                outcome = outcome.or(dial_state.receive(&packet, time_since(start, Instant::now())));
            }
        });
        match received {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(unreachable_failure(&error)),
        }
        match outcome {
            Some(HandshakeOutcome::Opened { connection, terms }) => {
                return Ok((connection, terms, dial_state.remark()));
            }
            Some(HandshakeOutcome::Refused) => {
                return Err(DialFailure::Refused(
                    "the cloud has too many connections already; close some, or raise the limit of open files (LimitNOFILE) on the cloud".into(),
                ));
            }
            None => {}
        }
    }
}

/// The state machine of an edge's socket.
#[derive(Debug)]
struct EdgeEnd {
    peer: SocketAddr,
    id: u64,
    connection: Connection,
    /// Remark on the opening, until it is handed to the layer above.
    remark: Option<String>,
    /// Descriptions of invalid packets, for the layer above.
    invalid_packets: VecDeque<String>,
    /// Random number for a path check: a sender that repeats this number has proved that it receives what is sent to
    /// its address.
    token: u64,
    /// Check of another address whose sender claims to be the cloud: the address, the time at which the check began,
    /// and whether the token must still be sent to the address.
    path_check: Option<(SocketAddr, MonoTime, bool)>,
}

/// Shortest interval between two tokens to other addresses.
const PATH_CHECK_INTERVAL: Span = Span::from_millis(100);

/// Maximum number of descriptions of invalid packets that wait for the layer above.
const MAX_INVALID_PACKETS: usize = 64;

impl Machine for EdgeEnd {
    type Delivery = (Result<EdgeEvent, Disconnection>, Option<Reservation>);

    fn receive(&mut self, source: SocketAddr, _local: Option<IpAddr>, body: &[u8], now: MonoTime) {
        // Only the IP addresses are compared, because the sending port of a RADIO socket is arbitrary.
        let is_other_address = source.ip() != self.peer.ip();
        match Packet::read(Role::Edge, body) {
            Ok(Packet::PathResponse { connection, token })
                if is_other_address && (connection, token) == (self.id, self.token) =>
            {
                self.peer = SocketAddr::new(source.ip(), self.peer.port());
                tracing::info!(peer = %self.peer, "the cloud has another address");
            }
            // The sender knows the connection and may be the cloud. This sender gets a token, and its packets are
            // ignored until it returns the token.
            Ok(packet) if is_other_address && packet.connection() == Some(self.id) => {
                if self.path_check.is_none_or(|(_, at, _)| now - at >= PATH_CHECK_INTERVAL) {
                    let (address, must_send) = (SocketAddr::new(source.ip(), self.peer.port()), true);
                    self.path_check = Some((address, now, must_send));
                }
            }
            _ if is_other_address => {}
            Ok(packet) if packet.connection() == Some(self.id) => self.connection.receive(packet, now),
            // A duplicated answer of the handshake, or a packet for an earlier socket at this port.
            Ok(_) => {}
            Err(error) if self.invalid_packets.len() < MAX_INVALID_PACKETS => {
                self.invalid_packets.push_back(error.to_string());
            }
            Err(_) => {}
        }
    }

    fn handle_port_unreachable(&mut self) {
        self.connection.end("no program listens at the peer's port any more");
    }

    fn tick(&mut self, now: MonoTime) {
        self.connection.tick(now);
    }

    fn next_timer(&self, now: MonoTime) -> Option<MonoTime> {
        (!self.connection.is_closed()).then(|| self.connection.next_timer(now))
    }

    fn fill(&mut self, out: &mut Vec<u8>, max_datagrams: usize, now: MonoTime) -> Option<(Route, Batch)> {
        if let Some((to, _, must_send @ true)) = &mut self.path_check {
            *must_send = false;
            let start = out.len();
            out.extend_from_slice(PREFIX);
            Packet::PathChallenge { connection: self.id, token: self.token }.write(Role::Edge, out);
            return Some((Route { to: *to, from: None }, Batch { segment: out.len() - start, count: 1 }));
        }
        let batch = self.connection.fill(out, max_datagrams, now)?;
        Some((Route { to: self.peer, from: None }, batch))
    }

    fn next_delivery(&mut self) -> Option<Self::Delivery> {
        if let Some(remark) = self.remark.take() {
            return Some((Ok(EdgeEvent::Remark(remark)), None));
        }
        if let Some(problem) = self.invalid_packets.pop_front() {
            return Some((Ok(EdgeEvent::InvalidData(problem)), None));
        }
        Some(match self.connection.next_event()? {
            Event::Message(frames, reserved) => (Ok(EdgeEvent::Message(frames)), Some(reserved)),
            Event::IncomingLost(loss) => (Ok(EdgeEvent::IncomingLost(loss)), None),
            Event::OutgoingLost(loss) => (Ok(EdgeEvent::OutgoingLost(loss)), None),
            Event::InvalidData(problem) => (Ok(EdgeEvent::InvalidData(problem)), None),
            Event::Gone(reason) => (Err(Disconnection(reason)), None),
        })
    }

    fn close(&mut self, now: MonoTime) {
        self.connection.close(now);
    }

    fn abandon(&mut self) {
        if !self.connection.is_closed() {
            self.connection.abandon();
        }
    }

    fn is_finished(&self) -> bool {
        self.connection.is_closed()
    }
}

#[derive(Debug)]
struct UdpEdgeSender(Arc<Port<EdgeEnd>>);

impl EdgeSender for UdpEdgeSender {
    fn send(&self, frames: Frames, options: SendOptions) -> Result<(), SendFailure> {
        let deadline = options.deadline.map(|deadline| self.0.time(deadline));
        self.0.with_machine(|end, _| end.connection.send(frames, options.tag, deadline))
    }

    fn addresses(&self) -> Option<ConnectionAddresses> {
        let (port, peer) = (self.0.socket.address().port(), self.0.with_machine(|end, _| end.peer));
        match source_address(peer) {
            Ok(ip) => Some(ConnectionAddresses { local: SocketAddr::new(ip, port), remote: peer }),
            Err(error) => {
                tracing::debug!(%error, %peer, "the system has no route to the cloud");
                None
            }
        }
    }

    fn caveat(&self) -> Option<&str> {
        self.0.socket.caveat()
    }

    fn statistics(&self) -> TransportStatistics {
        self.0.with_machine(|end, now| end.connection.statistics(now))
    }
}

#[derive(Debug)]
struct UdpEdgeReceiver {
    port: Arc<Port<EdgeEnd>>,
    deliveries: mpsc::Receiver<<EdgeEnd as Machine>::Delivery>,
}

impl Drop for UdpEdgeReceiver {
    fn drop(&mut self) {
        self.port.abort.cancel();
    }
}

impl EdgeReceiver for UdpEdgeReceiver {
    fn receive(&mut self) -> BoxFuture<'_, Result<EdgeEvent, Disconnection>> {
        Box::pin(async {
            match self.deliveries.recv().await {
                Some((event, _reserved)) => event,
                None => Err(Disconnection(CLOSED_HERE.into())),
            }
        })
    }

    fn close(mut self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()> {
        Box::pin(async move {
            discard_deliveries(&mut self.deliveries);
            self.port.close(linger).await;
        })
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use peernet_clock::{ClockIdentity, SharedClock, SystemClock};

    use super::*;
    use crate::transport::zmq_udp::bind;

    #[tokio::test]
    async fn next_address_is_tried_if_port_is_closed() {
        let settings = SessionSettings::default();
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "clock")));
        let address: Address = "udp://127.0.0.1:0".parse().expect("an address");
        let cloud = bind(&address, &settings, NonZeroUsize::MIN, &clock).await.expect("a free port");
        let open = SocketAddr::from(([127, 0, 0, 1], cloud.address.port()));
        // No program has the port of a socket that is closed again.
        let closed = std::net::UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr());
        let closed = closed.expect("a free port");
        assert!(matches!(dial_any([closed], &settings).await, Err(DialFailure::Unreachable(_))));
        assert!(dial_any([closed, open], &settings).await.is_ok());
    }
}
