//! The loop that accepts connections, the limits of connections and live streams, and the shutdown of all connections.
//!
//! At most [`Limits::connections`] connections are open at a time, and client addresses share them ([`FairSlots`]).
//! When all of them are open, a new connection replaces the oldest connection of the address with the most connections,
//! but only if that address has at least two more connections than the address of the new connection. Otherwise the new
//! connection is closed.
//!
//! Live streams never end. At most [`Limits::streams`] live streams are open, so that connections and processor time remain
//! for all other requests. Client addresses share the live streams as they share the connections, and one address has at
//! most [`Limits::streams_per_address`]. A request for a further live stream is answered with 503.
//!
//! A connection is closed if it does not complete a request header within [`Limits::header_timeout`], whether it is idle or sends byte by
//! byte. A connection whose peer reads nothing for [`Limits::unread_timeout`] is closed as well.

use std::io;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use peernet_clock::{LogThrottle, SharedClock};
use peernet_networks::AddressGroup;
use socket2::SockRef;
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

use crate::error::WebError;
use crate::fair_slots::{FairSlots, Slot, SlotRefusal};

/// Maximum number of bytes that are buffered for one connection, per direction.
const MAX_BUFFER_BYTES: usize = 64 << 10;
/// Maximum size of the request line and all headers together, bytes.
const MAX_HEADER_BYTES: usize = 64 << 10;
/// Delay before the next `accept` after an `accept` failed.
const ACCEPT_RETRY_DELAY: Duration = Duration::from_secs(1);
/// Maximum number of live streams of one client address. It limits the processor time that one client can use: the server
/// computes an update for each stream four times a second.
const MAX_STREAMS_PER_ADDRESS: usize = 32;

/// Limits of the server's connections.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Maximum number of open connections.
    pub connections: usize,
    /// Maximum number of open live streams.
    pub streams: usize,
    /// Maximum number of open live streams of one client address.
    pub streams_per_address: usize,
    /// Maximum time without a complete request header while no request is in progress.
    pub header_timeout: Duration,
    /// Maximum time that a peer may leave sent data unread (`TCP_USER_TIMEOUT`).
    pub unread_timeout: Duration,
    /// Maximum time that requests in progress may take after the server was asked to stop.
    pub grace_period: Duration,
}

impl Limits {
    /// Returns the limits of a running server with at most `connections` connections.
    pub(crate) fn server(connections: usize) -> Self {
        Self {
            connections,
            streams: connections / 4,
            streams_per_address: MAX_STREAMS_PER_ADDRESS,
            header_timeout: Duration::from_secs(10),
            unread_timeout: Duration::from_secs(30),
            // The whole process has 10 s for stopping (the default of `shutdown_deadline_s`).
            grace_period: Duration::from_millis(1_500),
        }
    }
}

/// Serves connections until `stop` is cancelled. Then waits until every connection is closed, and closes the connections
/// that are still open after [`Limits::grace_period`].
pub(crate) async fn accept(
    listener: TcpListener,
    router: Router,
    clock: SharedClock,
    stop: CancellationToken,
    limits: Limits,
) {
    // One address may have all connections, because it loses connections as soon as other addresses need them.
    let slots = FairSlots::new(limits.connections, usize::MAX);
    let stream_slots = FairSlots::new(limits.streams, limits.streams_per_address);
    let tasks = TaskTracker::new();
    let close_all = CancellationToken::new();
    let mut acceptor = Acceptor { slots, close_all: close_all.clone(), clock, log: LogThrottle::default() };
    while let Some(accepted) = stop.run_until_cancelled(acceptor.accept(&listener)).await {
        let AcceptedConnection { tcp_stream, address, evict, slot } = accepted;
        let stream_slots = StreamSlots { slots: stream_slots.clone(), address, evict: evict.clone() };
        let connection = serve(tcp_stream, router.clone(), stream_slots, stop.clone(), limits);
        tasks.spawn(async move {
            evict.run_until_cancelled(connection).await;
            // The slot is dropped after the connection, so that there are never more open connections than slots.
            drop(slot);
        });
    }
    // New connections are refused while the open connections finish.
    drop(listener);
    tasks.close();
    if tokio::time::timeout(limits.grace_period, tasks.wait()).await.is_err() {
        let requests = tasks.len();
        tracing::warn!(requests, grace = ?limits.grace_period, "requests were still in progress when the grace period of the web server ended; closing their connections");
        close_all.cancel();
        tasks.wait().await;
    }
}

/// The slots of live streams, with the address and the eviction token of the connection that requests a slot.
#[derive(Clone, Debug)]
pub(crate) struct StreamSlots {
    slots: FairSlots,
    address: AddressGroup,
    /// Closes the connection when this token is cancelled. A stream ends together with its connection, even while its client reads nothing.
    evict: CancellationToken,
}

impl StreamSlots {
    /// Acquires the slot of one more stream.
    ///
    /// # Errors
    /// [`WebError::TooManyStreams`] when the limit of the address or of all addresses is reached.
    pub(crate) async fn acquire(&self) -> Result<Slot, WebError> {
        self.slots.acquire(self.address, self.evict.clone()).await.map_err(|refusal| {
            WebError::TooManyStreams(match refusal {
                SlotRefusal::AddressLimitReached(count) => format!(
                    "{count} live streams are open from this address, which is the limit of one address; close a stream and try again"
                ),
                SlotRefusal::AllSlotsTaken(count) => format!(
                    "{count} live streams are open, which is the limit of all addresses together; try again when a stream has been closed"
                ),
            })
        })
    }
}

/// An accepted connection.
struct AcceptedConnection {
    tcp_stream: TcpStream,
    address: AddressGroup,
    /// Cancelled when another address needs the slot, and when all connections are closed.
    evict: CancellationToken,
    slot: Slot,
}

/// Accepts connections, and closes each connection that gets no slot.
struct Acceptor {
    slots: FairSlots,
    /// Closes all connections when this token is cancelled.
    close_all: CancellationToken,
    clock: SharedClock,
    log: LogThrottle,
}

impl Acceptor {
    /// Accepts connections until a connection gets a slot, and returns this connection.
    async fn accept(&mut self, listener: &TcpListener) -> AcceptedConnection {
        loop {
            match listener.accept().await {
                Ok((tcp_stream, peer)) => {
                    let (address, evict) = (AddressGroup::from_address(peer), self.close_all.child_token());
                    match self.slots.acquire(address, evict.clone()).await {
                        Ok(slot) => return AcceptedConnection { tcp_stream, address, evict, slot },
                        Err(_) => self.log_refusal(peer),
                    }
                }
                Err(error) if is_closed_by_peer(&error) => {}
                Err(error) => {
                    let address = None;
                    if let Some(times) = self.log.count_event(&error.to_string(), address, self.clock.mono())
                    {
                        tracing::error!(times, %error, "cannot accept a connection to the web server; trying again in one second");
                    }
                    // Usually, file descriptors or memory are exhausted. An immediate retry would fail again.
                    tokio::time::sleep(ACCEPT_RETRY_DELAY).await;
                }
            }
        }
    }

    fn log_refusal(&mut self, peer: SocketAddr) {
        // All addresses share one log line per minute, so their refusals are counted without an address.
        let address = None;
        if let Some(times) = self.log.count_event("full", address, self.clock.mono()) {
            tracing::warn!(times, %peer, "closed a new connection to the web server: the maximum number of connections is open, and no other address has at least two connections more than the address of the new connection");
        }
    }
}

/// Returns whether the peer closed the connection before it was accepted.
fn is_closed_by_peer(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

async fn serve(
    tcp_stream: TcpStream,
    router: Router,
    stream_slots: StreamSlots,
    stop: CancellationToken,
    limits: Limits,
) {
    if let Err(error) = SockRef::from(&tcp_stream).set_tcp_user_timeout(Some(limits.unread_timeout)) {
        // The peer has usually closed the connection already.
        tracing::debug!(%error, "cannot set TCP_USER_TIMEOUT of a connection to the web server; closing it");
        return;
    }
    let has_received_request = AtomicBool::new(false);
    let service = service_fn(|mut request: Request<Incoming>| {
        request.extensions_mut().insert(stream_slots.clone());
        // `Relaxed` suffices, because this task alone writes and reads the flag.
        has_received_request.store(true, Ordering::Relaxed);
        router.clone().oneshot(request)
    });
    // Browsers use HTTP/2 only over TLS, which this server does not have.
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.header_timeout)
        .max_buf_size(MAX_BUFFER_BYTES)
        .max_header_size(MAX_HEADER_BYTES)
        .serve_connection(TokioIo::new(tcp_stream), service);
    let mut connection = pin!(connection);
    let result = tokio::select! {
        result = connection.as_mut() => result,
        () = stop.cancelled() => {
            // `graceful_shutdown` closes an idle connection. But if a part of the connection's first header has
            // arrived, `graceful_shutdown` would wait for the rest of that header.
            if !has_received_request.load(Ordering::Relaxed) {
                return;
            }
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = result {
        tracing::debug!(%error, "a connection to the web server ended with an error");
    }
}

#[cfg(test)]
#[path = "connections_tests.rs"]
mod tests;
