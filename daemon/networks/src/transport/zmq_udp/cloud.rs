//! The cloud's end of all connections of a UDP port.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Duration;

use futures::future::BoxFuture;
use peernet_clock::{MonoTime, SharedClock, Span};
use tokio::sync::mpsc;
use tokio::time::Instant;

use super::driver::{Machine, Port};
use super::radio::PREFIX;
use super::socket::UdpPort;
use super::{connection_limits, local_terms, reassembly_limits, socket_buffer_bytes};
use crate::descriptors::DescriptorShare;
use crate::statistics::TransportStatistics;
use crate::transport::datagram::endpoint::Delivery;
use crate::transport::datagram::endpoint::{Endpoint, EndpointLimits, Route};
use crate::transport::datagram::sending::Batch;
use crate::transport::{
    BindFailure, BoundPort, CloudReceiver, CloudSender, ConnectionId, Frames, ListenerEvent, Peer,
    SendFailure, SendOptions, discard_deliveries,
};
use crate::{Address, SessionSettings};

/// Binds a socket and closes the socket again.
pub(crate) fn try_bind(address: &Address) -> io::Result<()> {
    std::net::UdpSocket::bind((address.host().as_str(), address.port())).map(drop)
}

/// Listens on a port.
pub(crate) async fn bind(
    address: &Address,
    settings: &SessionSettings,
    ports: NonZeroUsize,
    _clock: &SharedClock,
) -> Result<BoundPort, BindFailure> {
    let resolved = tokio::net::lookup_host(address.authority()).await;
    let resolved = resolved.map_err(|error| BindFailure::Other(error.to_string()))?.next();
    let local_address = resolved.ok_or_else(|| BindFailure::Other("the name has no address".into()))?;
    let socket = UdpPort::bind(local_address, socket_buffer_bytes(settings))?;
    let bound = socket.address();
    let caveat = socket.caveat().map(str::to_owned);
    let limits = EndpointLimits {
        connection: connection_limits(settings),
        reassembly: reassembly_limits(settings),
        max_unfinished_bytes: settings.max_unfinished_bytes,
        max_connections: DescriptorShare::DataPort.max_connections_per_port(ports),
        hello_timeout: Span::from(settings.hello_timeout()),
        terms: local_terms(settings, &socket),
    };
    // Two random UUIDs have 244 random bits.
    let mut secret = [0; 32];
    secret[..16].copy_from_slice(uuid::Uuid::new_v4().as_bytes());
    secret[16..].copy_from_slice(uuid::Uuid::new_v4().as_bytes());
    let machine = CloudEnd { endpoint: Endpoint::new(secret, PREFIX, limits), is_closing: false };
    let (port, deliveries) = Port::serve(socket, machine, Instant::now());
    let sender = Box::new(UdpCloudSender(Arc::clone(&port)));
    let address = address.with_ip(bound.ip(), bound.port());
    Ok(BoundPort { address, caveat, sender, receiver: Box::new(UdpCloudReceiver { port, deliveries }) })
}

/// The state machine of a cloud's socket.
#[derive(Debug)]
struct CloudEnd {
    endpoint: Endpoint,
    is_closing: bool,
}

impl Machine for CloudEnd {
    type Delivery = Delivery;

    fn receive(&mut self, source: SocketAddr, local: Option<IpAddr>, body: &[u8], now: MonoTime) {
        self.endpoint.receive(source, local, body, now);
    }

    // Reports of an unreachable port are ignored, because anyone can forge them. A peer that is gone is noticed by its
    // silence.
    fn handle_port_unreachable(&mut self) {}

    fn tick(&mut self, now: MonoTime) {
        self.endpoint.tick(now);
    }

    fn next_timer(&self, _now: MonoTime) -> Option<MonoTime> {
        self.endpoint.next_timer()
    }

    fn fill(&mut self, out: &mut Vec<u8>, max_datagrams: usize, now: MonoTime) -> Option<(Route, Batch)> {
        self.endpoint.fill(out, max_datagrams, now)
    }

    fn next_delivery(&mut self) -> Option<Delivery> {
        self.endpoint.next_delivery()
    }

    fn close(&mut self, now: MonoTime) {
        self.is_closing = true;
        self.endpoint.close(now);
    }

    fn abandon(&mut self) {
        self.endpoint.abandon();
    }

    fn is_finished(&self) -> bool {
        self.is_closing && self.endpoint.is_empty()
    }
}

#[derive(Debug)]
struct UdpCloudSender(Arc<Port<CloudEnd>>);

impl CloudSender for UdpCloudSender {
    fn send(&self, peer: &Peer, frames: Frames, options: SendOptions) -> Result<(), SendFailure> {
        self.0.with_machine(|end, _| end.endpoint.send(peer.connection, frames, options.tag))
    }

    fn note_hello(&self, connection: ConnectionId) {
        self.0.with_machine(|end, _| end.endpoint.note_hello(connection));
    }

    fn admit(&self, connection: ConnectionId) {
        self.0.with_machine(|end, _| end.endpoint.admit(connection));
    }

    fn demote(&self, connection: ConnectionId) {
        self.0.with_machine(|end, now| end.endpoint.demote(connection, now));
    }

    fn statistics(&self, connection: ConnectionId) -> TransportStatistics {
        self.0.with_machine(|end, now| end.endpoint.statistics(connection, now))
    }
}

#[derive(Debug)]
struct UdpCloudReceiver {
    port: Arc<Port<CloudEnd>>,
    deliveries: mpsc::Receiver<Delivery>,
}

impl Drop for UdpCloudReceiver {
    fn drop(&mut self) {
        self.port.abort.cancel();
    }
}

impl CloudReceiver for UdpCloudReceiver {
    fn receive(&mut self) -> BoxFuture<'_, Option<ListenerEvent>> {
        Box::pin(async { self.deliveries.recv().await.map(|delivery| delivery.event) })
    }

    fn close(mut self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()> {
        Box::pin(async move {
            discard_deliveries(&mut self.deliveries);
            self.port.close(linger).await;
        })
    }
}
